/* The C interface of a back end that evalkit loads from a shared library.  C99 and C++; one file, no dependency.
 *
 * Write these functions, build a shared library, and name it:  evalkit compare run.bag --backends lib:./libmine.so
 *
 *     cc  -O2 -shared -fPIC -I DIR mine.c -o libmine.so -lm      DIR: the folder of this file
 *
 * Metres, radians, nanoseconds.  x forward, y left, angles counter-clockwise.  A pose a_from_b takes coordinates in
 * frame b to frame a.  All pointers given to you are read-only and valid during the call only; strings are UTF-8.
 * Functions are called by one thread; several instances may exist at a time.  The same question must get the same
 * answer, to the bit.  Do not end the process, and do not throw C++ exceptions out of these functions.
 *
 * Required: evalkit_abi, evalkit_kind, evalkit_create, evalkit_destroy, and evalkit_register or evalkit_update as the
 * kind says.  The others may be left out.
 */
#ifndef EVALKIT_BACKEND_H
#define EVALKIT_BACKEND_H

#include <stddef.h>
#include <stdint.h>

#define EVALKIT_ABI 1

#define EVALKIT_REGISTRATION 1 /* brings one cloud onto another; evalkit's front end makes an odometry of it */
#define EVALKIT_ODOMETRY 2     /* follows a whole sequence with a map of its own */

#if defined(_WIN32)
#define EVALKIT_EXPORT __declspec(dllexport)
#else
#define EVALKIT_EXPORT __attribute__((visibility("default")))
#endif

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    double x, y, theta; /* m, m, rad */
} evalkit_pose;

typedef struct {
    evalkit_pose target_from_source; /* always finite: the guess where you have nothing better */
    double error_m;                  /* your own final error; NAN where you have none */
    int32_t converged;               /* 0 or 1; not converging is an answer, not an error */
    int32_t iterations;
    int32_t inliers;                 /* pairs the answer stands on; where these are few the guess is kept */
} evalkit_match;

typedef struct {
    int64_t stamp_ns;              /* when the first beam was fired */
    int64_t time_increment_ns;     /* between two beams; 0: all at once */
    const double *ranges;          /* m; INFINITY: no return; NAN: invalid */
    const double *angles;          /* rad, in the sensor's frame, in the order the beams were fired */
    size_t beams;
    double range_min_m, range_max_m;
    evalkit_pose base_from_sensor; /* where the lidar sits */
    const evalkit_pose *odom_from_base; /* the wheels' pose at the first beam, or NULL */
    const evalkit_pose *start_from_end; /* the wheels' motion from the first beam to the last, or NULL */
} evalkit_frame;

/* Hears of one iteration: the error (m) and pairs before it, the pose after it.  Pass `listener` on as you got it. */
typedef void (*evalkit_trace)(void *listener, double error_m, int32_t inliers, const evalkit_pose *target_from_source);

/* EVALKIT_ABI, the version of this file you were compiled with. */
EVALKIT_EXPORT int32_t evalkit_abi(void);

/* EVALKIT_REGISTRATION or EVALKIT_ODOMETRY. */
EVALKIT_EXPORT int32_t evalkit_kind(void);

/* Optional: one line that says what this is, for the report. */
EVALKIT_EXPORT const char *evalkit_summary(void);

/* Optional: what can be set, one line each:  NAME DEFAULT UNIT MEANING
 * The default tells the type: "true" or "false", 40 (whole), 0.5 (number), anything else is a text without spaces.
 * "-" for no unit.  Example:  "max_correspondence_m 0.5 m largest distance of a pair\nmax_iterations 40 - most of them\n"
 */
EVALKIT_EXPORT const char *evalkit_parameters(void);

/* A new instance; NULL if that is impossible (say why in evalkit_last_error(NULL)).
 * Every parameter you declared comes with a value of its type, in the order you declared them. */
EVALKIT_EXPORT void *evalkit_create(const char *const *names, const char *const *values, size_t count);

/* Kind registration: brings the source onto the target, starting from the guess (target_from_source).
 * Points are x0 y0 x1 y1 ...; counts are points, and may be 0; every coordinate is finite.  Keep nothing between calls
 * that changes an answer.  `trace` may be NULL; else call it once an iteration.
 * Fill in *answer and return 0, or return a code of your own for what makes the whole run pointless. */
EVALKIT_EXPORT int32_t evalkit_register(void *self, const double *target_xy, size_t targets, const double *source_xy,
                                        size_t sources, const evalkit_pose *guess, evalkit_trace trace, void *listener,
                                        evalkit_match *answer);

/* Kind odometry: *answer is start_from_base when the frame's first beam was fired, the identity for the first frame.
 * A fresh instance per sequence; frames come in the order of time.  Return 0, or a code of your own. */
EVALKIT_EXPORT int32_t evalkit_update(void *self, const evalkit_frame *frame, evalkit_pose *answer);

/* Frees what evalkit_create made. */
EVALKIT_EXPORT void evalkit_destroy(void *self);

/* Optional: what went wrong last, or NULL; `self` is NULL after a failed evalkit_create. */
EVALKIT_EXPORT const char *evalkit_last_error(void *self);

#ifdef __cplusplus
}
#endif
#endif

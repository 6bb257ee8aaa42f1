/* The C interface of a back end that evalkit loads from a shared library.  C99 and C++; one file, no dependency.
 *
 * Write these functions, build a shared library, and name it:  evalkit compare run.bag --backends lib:./libmine.so
 *
 *     cc  -O2 -shared -fPIC -I DIR mine.c -o libmine.so -lm      DIR: the folder of this file
 *
 * Metres, radians, nanoseconds.  x forward, y left, angles counter-clockwise.  A pose a_from_b takes coordinates in
 * frame b to frame a.  All pointer arguments are read-only and valid only during the call; strings are UTF-8.
 * One thread calls the functions; several instances may exist at the same time.  Equal arguments must give bit-identical
 * results.  Do not end the process, and let no C++ exception leave these functions.
 *
 * Required: evalkit_abi, evalkit_kind, evalkit_create, evalkit_destroy, and, depending on the kind, evalkit_register,
 * or evalkit_update, or evalkit_update and evalkit_trajectory.  The others are optional.
 */
#ifndef EVALKIT_BACKEND_H
#define EVALKIT_BACKEND_H

#include <stddef.h>
#include <stdint.h>

#define EVALKIT_ABI 1

#define EVALKIT_REGISTRATION 1 /* aligns one cloud with another; evalkit's front end makes it an odometry */
#define EVALKIT_ODOMETRY 2     /* estimates the motion over a whole sequence with its own map */
#define EVALKIT_SLAM 3         /* an odometry that also corrects poses it has given */

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
    evalkit_pose target_from_source; /* always finite; the guess where there is no better pose */
    double error_m;                  /* final error of the method; NAN without one */
    int32_t converged;               /* 0 or 1; not to converge is a result, not an error */
    int32_t iterations;
    int32_t inliers;                 /* number of pairs; with few of them the guess is kept */
} evalkit_match;

typedef struct {
    int64_t stamp_ns;              /* when the first beam was fired */
    int64_t time_increment_ns;     /* between two beams; 0: all at once */
    const double *ranges;          /* m; INFINITY: no return; NAN: invalid */
    const double *angles;          /* rad, in the sensor's frame, in the order the beams were fired */
    size_t beams;
    double range_min_m, range_max_m;
    evalkit_pose base_from_sensor; /* mounting pose of the lidar */
    const evalkit_pose *odom_from_base; /* the wheels' pose at the first beam, or NULL */
    const evalkit_pose *start_from_end; /* the wheels' motion from the first beam to the last, or NULL */
} evalkit_frame;

typedef struct {
    int64_t stamp_ns, other_stamp_ns; /* the later and the earlier of two frames */
    evalkit_pose other_from_base;     /* measured pose of the base at the later frame in the base at the earlier one */
    int32_t accepted;                 /* 0 or 1: whether the motion is used now */
    const char *reason;               /* why, 1 to 200 bytes; valid until the next call of a function */
} evalkit_loop_closure;

/* Callback for one iteration: its pairs, their error (m), and the pose after it.  Pass `listener` on unchanged. */
typedef void (*evalkit_trace)(void *listener, double error_m, int32_t inliers, const evalkit_pose *target_from_source);

/* Return EVALKIT_ABI, the version of this file at compile time. */
EVALKIT_EXPORT int32_t evalkit_abi(void);

/* EVALKIT_REGISTRATION, EVALKIT_ODOMETRY or EVALKIT_SLAM. */
EVALKIT_EXPORT int32_t evalkit_kind(void);

/* Optional: one line of description for the report. */
EVALKIT_EXPORT const char *evalkit_summary(void);

/* Optional: the parameters, one line each:  NAME DEFAULT UNIT MEANING
 * The default determines the type: "true" or "false", 40 (whole), 0.5 (number), anything else is a text without spaces.
 * "-" for no unit.  Example:  "max_correspondence_m 0.5 m largest distance of a pair\nmax_iterations 40 - largest number\n"
 */
EVALKIT_EXPORT const char *evalkit_parameters(void);

/* Make a new instance; NULL on failure (evalkit_last_error(NULL) then returns the reason).
 * Every declared parameter has a value of its type, in the order of declaration. */
EVALKIT_EXPORT void *evalkit_create(const char *const *names, const char *const *values, size_t count);

/* Kind registration: align the source with the target, starting from the guess (target_from_source).
 * Points are x0 y0 x1 y1 ...; counts are numbers of points and may be 0; every coordinate is finite.  No state between
 * calls may change a result.  `trace` may be NULL; otherwise call it once per iteration.
 * Set *answer and return 0, or return another code to end the run as failed. */
EVALKIT_EXPORT int32_t evalkit_register(void *self, const double *target_xy, size_t targets, const double *source_xy,
                                        size_t sources, const evalkit_pose *guess, evalkit_trace trace, void *listener,
                                        evalkit_match *answer);

/* Optional: the pairs behind the current call of `trace`: source and target index in turns, 2 * *count numbers; NULL for
 * none.  Called during `trace` only; the numbers stay valid until `trace` returns. */
EVALKIT_EXPORT const int32_t *evalkit_pairs(void *self, size_t *count);

/* Kinds odometry and SLAM: set *answer to start_from_base at the frame's first beam; the identity for the first frame.
 * Every sequence has a new instance; frames are in the order of time.  Return 0, or another code to end the run. */
EVALKIT_EXPORT int32_t evalkit_update(void *self, const evalkit_frame *frame, evalkit_pose *answer);

/* Kind SLAM: write the corrected start_from_base of every frame for which evalkit_update returned 0, oldest first: `count`
 * poses, which the caller owns; the first is the identity.  Called after the last frame and after one that corrected
 * poses (evalkit_corrected); evalkit validate calls it after others too.  It must not change a later answer.  Return 0, or
 * another code: after the last frame, it ends the run as failed; before, the page shows no later correction. */
EVALKIT_EXPORT int32_t evalkit_trajectory(void *self, evalkit_pose *poses, size_t count);

/* Optional, kind SLAM: write the first `room` loop closures, rejected candidates included, in the order of stamp_ns; return
 * the number of all, at most 100000.  Called with room 0 and NULL first.  It must not change a later answer. */
EVALKIT_EXPORT size_t evalkit_loop_closures(void *self, evalkit_loop_closure *closures, size_t room);

/* Optional, kind SLAM: 1 if the track was lost and this motion found the place again, else 0; `closure`: its index among
 * those of evalkit_loop_closures, after which it is called.  It must not change a later answer. */
EVALKIT_EXPORT int32_t evalkit_found_again(void *self, size_t closure);

/* Optional, kind SLAM: 1 if the last evalkit_update moved the pose of an earlier frame by more than 1 cm or 0.5 deg, else 0. */
EVALKIT_EXPORT int32_t evalkit_corrected(void *self);

/* Free an instance of evalkit_create. */
EVALKIT_EXPORT void evalkit_destroy(void *self);

/* Optional: return the last error message, or NULL; `self` is NULL after a failed evalkit_create. */
EVALKIT_EXPORT const char *evalkit_last_error(void *self);

#ifdef __cplusplus
}
#endif
#endif

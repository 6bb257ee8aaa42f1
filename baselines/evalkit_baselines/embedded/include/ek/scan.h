/* scan.h - project lidar ranges to points in the base frame (paper, equation 1) and deskew them. */
#ifndef EK_SCAN_H
#define EK_SCAN_H

#include "ek/arena.h"
#include "ek/se2.h"

#ifdef __cplusplus
extern "C" {
#endif

/* One revolution, beams in firing order. */
typedef struct {
    int64_t stamp_ns;          /* of the first beam */
    int64_t time_increment_ns; /* between two beams; 0: all at once */
    const ek_real *ranges;     /* m; inf: no return, nan: invalid */
    const ek_real *angles;     /* rad, counter-clockwise from the sensor's x axis */
    size_t beams;
    int32_t has_odometry;   /* 1: odom_from_base is known */
    int32_t has_motion;     /* 1: start_from_end is known */
    ek_pose odom_from_base; /* the wheel odometry's pose when the first beam was fired */
    ek_pose start_from_end; /* the base's motion from the first beam to the last */
} ek_sweep;

typedef struct {
    ek_pose base_from_sensor;
    ek_real range_min, range_max; /* m; beams outside are ignored; 0 <= min < max <= 1000 */
    ek_real local_radius;         /* m around the base; farther points are ignored; 0 keeps all */
} ek_scan_parameters;

typedef struct {
    size_t capacity;
    size_t count;     /* number of hits */
    size_t misses;    /* number of beams without return */
    ek_real *hits;    /* count pairs x y in the base frame (m), firing order */
    ek_real *ends;    /* misses pairs x y: end points at range_max of beams without return */
    ek_real *angle, *cosine, *sine; /* cached directions of the last sweep */
} ek_scan;

#define ek_is_hit EK_NAME(is_hit)
#define ek_scan_check EK_NAME(scan_check)
#define ek_scan_init EK_NAME(scan_init)
#define ek_scan_project EK_NAME(scan_project)

/* 1 if a range is that of a hit, which nan is not. */
static inline int ek_is_hit(ek_real range, ek_real low, ek_real high)
{
    return range >= low && range <= high;
}

/* Check parameters: EK_OK, EK_NOT_FINITE or EK_OUT_OF_RANGE. */
ek_status ek_scan_check(const ek_scan_parameters *parameters);

/* Initialise a scan of up to `capacity` beams in an arena (or measure it). EK_OUT_OF_RANGE: 0 or above 2^30. */
ek_status ek_scan_init(ek_scan *scan, ek_arena *arena, size_t capacity);

/* Compute hits and ends, deskewed to the time of the first beam: the base moves by `start_from_end` at constant
 * velocity during the sweep (NULL: at rest). Beams that are nan, -inf, too near or too far are ignored; +inf is a miss.
 * EK_NO_POINTS: no beams; EK_TOO_MANY_POINTS; EK_NOT_FINITE: an angle or the motion. After an error the scan is empty.
 */
ek_status ek_scan_project(ek_scan *scan, const ek_sweep *sweep, const ek_scan_parameters *parameters,
                          const ek_pose *start_from_end);

#ifdef __cplusplus
}
#endif
#endif

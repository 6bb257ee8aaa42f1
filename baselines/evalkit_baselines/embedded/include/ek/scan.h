/* scan.h - from what a lidar measures to points in the robot's frame (the paper, equation 1), motion undone. */
#ifndef EK_SCAN_H
#define EK_SCAN_H

#include "ek/arena.h"
#include "ek/se2.h"

#ifdef __cplusplus
extern "C" {
#endif

/* One revolution or sweep, beams in the order they were fired. */
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
    ek_real range_min, range_max; /* m; beams outside do not count; 0 <= min < max <= 1000 */
    ek_real local_radius;         /* m around the base; points farther away do not count; 0 keeps all */
} ek_scan_parameters;

typedef struct {
    size_t capacity;
    size_t count;     /* of hits */
    size_t misses;    /* of beams without return */
    ek_real *hits;    /* count pairs x y in the base frame (m), in firing order */
    ek_real *ends;    /* misses pairs x y: where beams without return leave the sensor's range */
    ek_real *angle, *cosine, *sine; /* directions known from the last sweep */
} ek_scan;

#define ek_scan_check EK_NAME(scan_check)
#define ek_scan_lay_out EK_NAME(scan_lay_out)
#define ek_scan_project EK_NAME(scan_project)

/* EK_OK, EK_NOT_FINITE or EK_OUT_OF_RANGE. */
ek_status ek_scan_check(const ek_scan_parameters *parameters);

/* Lays a scan of up to `capacity` beams out. EK_OUT_OF_RANGE: 0 or above 2^30. */
ek_status ek_scan_lay_out(ek_scan *scan, ek_arena *arena, size_t capacity);

/* Fills hits and ends as if every beam had been fired at the first beam's time by a base that moves steadily by
 * `start_from_end` meanwhile (NULL: at rest). nan, -inf, too near and too far beams are left out; +inf is a miss.
 * EK_NO_POINTS: no beams; EK_TOO_MANY_POINTS; EK_NOT_FINITE: an angle or the motion. After an error the scan is empty.
 */
ek_status ek_scan_project(ek_scan *scan, const ek_sweep *sweep, const ek_scan_parameters *parameters,
                          const ek_pose *start_from_end);

#ifdef __cplusplus
}
#endif
#endif

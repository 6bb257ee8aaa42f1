/* scanlog.h - read recorded scans from a small binary file. Needs a C library with file access.
 *
 * All numbers are little-endian, IEEE 754. Header:
 *   "EKSL"  u32 version (1)  u32 max_beams of a scan  f64 range_min  f64 range_max (m)
 *   f64 x y theta of base_from_sensor
 * Then for each scan:
 *   i64 stamp_ns  i64 time_increment_ns  u32 beams  u32 flags (1: odometry, 2: motion within the scan)
 *   if flag 1: f64 x y theta of odom_from_base      if flag 2: f64 x y theta of start_from_end
 *   f32 ranges[beams] (m; inf: no return, nan: invalid)  f32 angles[beams] (rad)
 */
#ifndef EK_SCANLOG_H
#define EK_SCANLOG_H

#include <stdio.h>

#include "ek/scan.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    uint32_t max_beams;
    ek_real range_min, range_max;
    ek_pose base_from_sensor;
} ek_scanlog;

#define ek_scanlog_open EK_NAME(scanlog_open)
#define ek_scanlog_next EK_NAME(scanlog_next)

/* Read the header. EK_BAD_FILE: not a scan log, another version, or truncated. */
ek_status ek_scanlog_open(FILE *file, ek_scanlog *log);

/* Read the next scan into ranges and angles, arrays of log->max_beams entries; *sweep then points to them.
 * EK_END_OF_FILE after the last; EK_BAD_FILE: truncated, or more beams than the header allows. */
ek_status ek_scanlog_next(FILE *file, const ek_scanlog *log, ek_real *ranges, ek_real *angles, ek_sweep *sweep);

#ifdef __cplusplus
}
#endif
#endif

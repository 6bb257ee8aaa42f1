/* sweep_times.h - find out that a lidar turns once a scan where its scans have no times of beams.
 *
 * Computes the same as evalkit_baselines/slam/sweep_times.py, which gives the reasons.
 */
#ifndef EK_SWEEP_TIMES_H
#define EK_SWEEP_TIMES_H

#include "ek/observability.h"
#include "ek/scan.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ek_sweep_times EK_NAME(sweep_times)
#define ek_sweep_times_applies EK_NAME(sweep_times_applies)
#define ek_sweep_times_take EK_NAME(sweep_times_take)
#define ek_sweep_times_observe EK_NAME(sweep_times_observe)

/* Zeroed: nothing is known. */
typedef struct {
    int32_t order;          /* 1: one turn a period, in the order of the beams; -1: in the opposite order; 0: all at once */
    ek_real share;          /* of the period that a sweep takes, as far as it is known; negative in the opposite order */
    ek_real squared, moved; /* m^2: sums of squared displacements, and of those times residuals */
} ek_sweep_times;

/* A matched scan: its motion since the last one `elapsed_ns` ago, and the period of the scans. */
typedef struct {
    ek_pose step;
    int64_t elapsed_ns, period_ns;
} ek_sweep_step;

/* 1 if a sweep spans a full circle without times of beams. */
int ek_sweep_times_applies(const ek_sweep *sweep);

/* How long a sweep took (ns), negative where beams are fired in the opposite order; 0: all beams are fired at once, or have
 * times, or nothing is known yet. `period_ns`: of the scans; 0: unknown. */
int64_t ek_sweep_times_take(const ek_sweep_times *times, const ek_sweep *sweep, int64_t period_ns);

/* Take what an observer has taken of such a scan, at a pose on the map whose points are paired within `limit` (m). `sweep`: as
 * it came. Scans between which the robot hardly turned tell nothing. */
void ek_sweep_times_observe(ek_sweep_times *times, const ek_observer *observer, const ek_index *map, ek_pose pose,
                            ek_real limit, const ek_sweep *sweep, ek_pose base_from_sensor, const ek_sweep_step *step);

#ifdef __cplusplus
}
#endif
#endif

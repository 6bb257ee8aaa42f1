/* continuity.h - whether a scan continues the one before it, or the track was lost.
 *
 * Computes the same as evalkit_baselines/slam/continuity.py: the share of points that lie on the scan before, of those
 * that it could see.
 * With odometry a point that lies on the local map counts too.
 */
#ifndef EK_CONTINUITY_H
#define EK_CONTINUITY_H

#include "ek/index.h"
#include "ek/se2.h"
#include "ek/thin.h"
#include "ek/sight.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    ek_index before; /* points of the scan before, at its pose; empty: there is none */
    ek_sight sight;  /* of the scan before */
    ek_real *moved;  /* points, thinned */
    uint32_t *seen;
    ek_pose sensor;  /* pose of the scan before */
} ek_continuity;

#define ek_continuity_init EK_NAME(continuity_init)
#define ek_continuity_is_lost EK_NAME(continuity_is_lost)
#define ek_continuity_keep EK_NAME(continuity_keep)

/* Initialise for scans of up to `capacity` points in an arena (or measure it). Returns what ek_index_init returns. */
ek_status ek_continuity_init(ek_continuity *continuity, ek_arena *arena, size_t capacity);

/* Compare scans with this one from now on: count pairs x y of the base frame (m), finite and within EK_MAX_COORDINATE, at
 * most `capacity`. One of too few points changes nothing. At most 60 operations a point. */
void ek_continuity_keep(ek_continuity *continuity, ek_thinner *thinner, const ek_real *xy, size_t count,
                        ek_pose odom_from_base, ek_pose base_from_sensor, ek_work *work);

/* 1 if a scan contradicts the one that was kept, each at its own pose; at most 400 points are asked, of the scan thinned to
 * 0.1 m. `is_predicted`: by wheel odometry, or soon after the scan before; then what lies on the map counts, too. Points that
 * the scan before could not see do not count; with too few others a prediction is accepted, and without one the track is
 * lost. At most 60 operations a point. */
int ek_continuity_is_lost(ek_continuity *continuity, ek_thinner *thinner, const ek_real *xy, size_t count,
                          ek_pose odom_from_base, int is_predicted, const ek_index *map, ek_work *work);

#ifdef __cplusplus
}
#endif
#endif

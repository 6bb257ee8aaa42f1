/* observability.h - which direction the walls of a scan leave open.
 *
 * Computes the same as evalkit_baselines/slam/observability.py: the eigenvalues of the scatter of some 100 to 200 normals
 * of a cloud thinned to 0.1 m.
 */
#ifndef EK_OBSERVABILITY_H
#define EK_OBSERVABILITY_H

#include "ek/index.h"
#include "ek/se2.h"
#include "ek/thin.h"

#ifdef __cplusplus
extern "C" {
#endif

#define EK_ROOM_RATIO EK_R(0.2) /* ratios of eigenvalues in rooms are larger */

/* The unit direction in the scan's frame that the walls fix least, and the ratio of the eigenvalues, 0 to 1; the turn about a
 * place (m) that they fix least, and which share of it they leave open, 0 to 1. */
typedef struct {
    ek_real x, y, ratio;
    ek_real centre_x, centre_y, open_turn;
} ek_openness;

/* Read only. */
typedef struct {
    ek_index index;
    ek_real *thinned, *normals;
    size_t cells, every; /* points of the thinned cloud; every n-th of them has a normal */
} ek_observer;

#define ek_observer_init EK_NAME(observer_init)
#define ek_observer_take EK_NAME(observer_take)
#define ek_observer_measure EK_NAME(observer_measure)
#define ek_observer_measure_on EK_NAME(observer_measure_on)
#define ek_openness_trust EK_NAME(openness_trust)
#define ek_openness_limit EK_NAME(openness_limit)
#define ek_openness_is_closed EK_NAME(openness_is_closed)
#define ek_openness_is_room EK_NAME(openness_is_room)

/* Initialise for clouds of up to `capacity` points in an arena (or measure it). Returns what ek_index_init returns. */
ek_status ek_observer_init(ek_observer *observer, ek_arena *arena, size_t capacity);

/* Take a cloud to measure: count pairs x y (m), finite and within EK_MAX_COORDINATE, at most `capacity`. At most 200 operations
 * a point. */
void ek_observer_take(ek_observer *observer, ek_thinner *thinner, const ek_real *xy, size_t count, ek_work *work);

/* What the points within `reach` (m) of the origin leave open; of fewer than eight, all directions. */
ek_openness ek_observer_measure(const ek_observer *observer, ek_real reach);

/* The same of the points that have one of the target nearer than `limit` (m) when the cloud is at a pose on it: a wall that has
 * just come into view is in no map yet, and fixes nothing. */
ek_openness ek_observer_measure_on(const ek_observer *observer, const ek_index *target, ek_pose pose, ek_real limit);

/* Share, 0 to 1, of a match that counts along the open direction. */
ek_real ek_openness_trust(const ek_openness *open);

/* Whether the walls fix everything. */
int ek_openness_is_closed(const ek_openness *open);

/* Whether they do it well, as in rooms. */
int ek_openness_is_room(const ek_openness *open);

/* The pose of a match, with the guess along the open direction of the scan, and about its open turn. */
ek_pose ek_openness_limit(const ek_openness *open, ek_pose match, ek_pose guess);

#ifdef __cplusplus
}
#endif
#endif

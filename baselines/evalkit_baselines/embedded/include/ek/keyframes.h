/* keyframes.h - the keyframes of a drive: their points, the graph that connects them, and distances through it.
 *
 * Computes the same as evalkit_baselines/slam/keyframes.py, with room for a fixed number of keyframes and points.
 */
#ifndef EK_KEYFRAMES_H
#define EK_KEYFRAMES_H

#include "ek/observability.h"
#include "ek/pose_graph.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How the motion between two keyframes is known: matched, or after a lost track by wheel odometry alone, or not. */
typedef enum { EK_STEP_MATCHED = 0, EK_STEP_MEASURED, EK_STEP_UNKNOWN } ek_step_kind;

/* Distances through the graph: from the first one on, two keyframes are connected by steps by odometry alone only; from
 * the second one on not at all. */
#define EK_DOUBTED EK_R(1e9)
#define EK_APART EK_R(1e12)

/* Assumed random errors of matched motions, 1 sigma after one metre; they grow with the root of the path. */
typedef struct {
    ek_real sigma;       /* m */
    ek_real sigma_theta; /* rad */
} ek_drift;

/* Variance that a step has beyond that of the drift, where its matches fit poorly: of each coordinate (m^2) and of the
 * heading (rad^2). */
typedef struct {
    ek_real position, heading;
} ek_doubt;

typedef struct {
    size_t capacity, point_capacity;
    size_t count;
    ek_pose_graph graph;
    ek_drift drift;
    ek_real *points;     /* of all keyframes, each in its own frame; pairs x y (m) */
    ek_real *sensor;     /* where the points of each were seen from, x y in its frame (m) */
    size_t *start;       /* first point of a keyframe; count + 1 entries */
    ek_real *path;       /* driven distance (m) */
    ek_real *apart;      /* distance from the last keyframe along steps and loops (m), or EK_APART */
    uint32_t *section;   /* part of the drive without a lost track */
    uint8_t *kind;       /* ek_step_kind of the step to a keyframe */
} ek_keyframes;

#define ek_keyframes_init EK_NAME(keyframes_init)
#define ek_keyframes_add EK_NAME(keyframes_add)
#define ek_keyframes_measure EK_NAME(keyframes_measure)
#define ek_keyframes_join EK_NAME(keyframes_join)

/* Initialise in an arena (or measure it). EK_OUT_OF_RANGE: no points, or what ek_pose_graph_init refuses. */
ek_status ek_keyframes_init(ek_keyframes *keyframes, ek_arena *arena, size_t capacity, size_t points, size_t loops,
                            ek_drift drift);

/* Add a keyframe by its motion from the last one: count pairs x y in its own frame, seen from `sensor`, x y (m).
 * EK_TOO_MANY_POINTS: no room for it or its points; what ek_pose_graph_add refuses. An error changes nothing. One operation a
 * keyframe. */
ek_status ek_keyframes_add(ek_keyframes *keyframes, const ek_real *xy, size_t count, const ek_real *sensor,
                           ek_pose last_from_keyframe, ek_step_kind kind, const ek_openness *open, ek_doubt doubt, ek_work *work);

/* Measure the distances through the graph again: at most one pass of all keyframes for each loop. */
void ek_keyframes_measure(ek_keyframes *keyframes, ek_work *work);

/* Move all that is connected with the last keyframe to where a loop from another part of the drive puts it.
 * `contradicts`: the steps by odometry alone between these parts are not known any more. */
void ek_keyframes_join(ek_keyframes *keyframes, const ek_loop_edge *loop, int contradicts, ek_work *work);

#ifdef __cplusplus
}
#endif
#endif

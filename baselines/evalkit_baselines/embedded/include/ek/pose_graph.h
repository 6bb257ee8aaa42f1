/* pose_graph.h - optimise the poses of a drive: a chain of steps and a bounded number of loops; work in slices.
 *
 * Gauss-Newton on SE(2) as in evalkit_baselines/slam/pose_graph.py: the residual of an edge is x, y, theta of
 * measured^-1 (first^-1 second), the first pose stays. The normal equations of all poses are not formed: the steps are a
 * chain, so each change of a pose is a sum of changes of steps, and a problem with as many unknowns as the loops have
 * residuals remains (the dual problem). An iteration is linear in the poses and cubic in the loops, and memory is linear
 * in the poses and square in the loops; the solution is the same.
 *
 * Robust: dynamic covariance scaling (Agarwal et al., ICRA 2013), and graduated non-convexity with truncated least
 * squares (Yang et al., RA-L 2020). Steps are never doubted.
 */
#ifndef EK_POSE_GRAPH_H
#define EK_POSE_GRAPH_H

#include "ek/arena.h"
#include "ek/se2.h"
#include "ek/sym3.h"
#include "ek/work.h"

#ifdef __cplusplus
extern "C" {
#endif

#define EK_MOVE_WORK 6u /* operations for a pose that is moved as another one was */

/* A measured motion between two poses of the chain; residuals are in the frame of its measured second pose. */
typedef struct {
    uint32_t first, second; /* first < second */
    ek_pose first_from_second;
    ek_sym3 information; /* 1/m^2, 1/(m rad), 1/rad^2 */
    ek_real weight;      /* 0 to 1: the factor of the information at the end of the last optimisation */
} ek_loop_edge;

/* The step to a pose from the one before; unused for the first pose. */
typedef struct {
    ek_pose last_from_pose;
    ek_sym3 information;
} ek_step;

/* A run of Gauss-Newton. Stops where the sum of weighted chi-squares changes by less than the share `tolerance`. */
typedef struct {
    int32_t max_iterations;
    ek_real tolerance;
    ek_real phi; /* of dynamic covariance scaling; 0: weights as they are */
} ek_solver_settings;

typedef enum {
    EK_SOLVER_IDLE = 0,
    EK_SOLVER_CHAIN,
    EK_SOLVER_LOOPS,
    EK_SOLVER_MATRIX,
    EK_SOLVER_BACK,
    EK_SOLVER_MOVE
} ek_solver_phase;

/* State of a run; `node`, `row`, `column` say where the next slice goes on. */
typedef struct {
    ek_solver_phase phase;
    ek_solver_settings settings;
    int32_t iterations, converged, singular;
    size_t nodes;         /* poses that take part */
    size_t node, row, column, active;
    ek_real chi_square, before;
    ek_pose origin;       /* twists are about this position, which keeps their digits in a float build */
    ek_pose last;         /* of the pose before `node`, before it moved */
    ek_real twist[3], pull[3];
    int32_t predict;      /* 1: compute the covariance of the motion between two poses instead of a step */
    uint32_t predict_first, predict_second;
    ek_sym3 predicted;
} ek_solver;

typedef struct {
    size_t capacity, loop_capacity;
    size_t count, loop_count;
    ek_pose *pose;      /* world_from_pose; the first is the identity */
    ek_step *step;
    ek_loop_edge *loop;
    /* working memory */
    ek_pose *moved;     /* poses of the run; ek_pose_graph_commit takes them over */
    ek_sym3 *covariance; /* sum of the steps' covariances up to a pose, as twists of the world */
    ek_real *offset;    /* sum of the steps' residuals up to a pose, 3 each */
    ek_real *chi;       /* chi-square of each loop */
    uint32_t *used;     /* loops with a weight */
    ek_real *matrix;    /* blocks of 3 x 3, lower triangle by rows */
    ek_real *right;     /* 3 per loop */
    ek_solver solver;
} ek_pose_graph;

#define ek_pose_graph_init EK_NAME(pose_graph_init)
#define ek_pose_graph_reset EK_NAME(pose_graph_reset)
#define ek_pose_graph_add EK_NAME(pose_graph_add)
#define ek_pose_graph_close EK_NAME(pose_graph_close)
#define ek_pose_graph_begin EK_NAME(pose_graph_begin)
#define ek_pose_graph_predict EK_NAME(pose_graph_predict)
#define ek_pose_graph_work EK_NAME(pose_graph_work)
#define ek_pose_graph_commit EK_NAME(pose_graph_commit)
#define ek_pose_graph_chi EK_NAME(pose_graph_chi)

/* Initialise an empty graph in an arena (or measure it). EK_OUT_OF_RANGE: poses 0 or above 2^20, loops 0 or above 1024. */
ek_status ek_pose_graph_init(ek_pose_graph *graph, ek_arena *arena, size_t poses, size_t loops);

/* Remove all poses and loops. */
void ek_pose_graph_reset(ek_pose_graph *graph);

/* Append a pose by its step from the last one (ignored for the first). EK_TOO_MANY_POINTS: the graph is full;
 * EK_NOT_FINITE; EK_OUT_OF_RANGE: information that is not positive definite. An error changes nothing. */
ek_status ek_pose_graph_add(ek_pose_graph *graph, ek_pose last_from_pose, const ek_sym3 *information);

/* Add a loop with weight 1. EK_TOO_MANY_POINTS: no room; EK_OUT_OF_RANGE: first and second are not poses in ascending
 * order, or information that is not positive definite; EK_NOT_FINITE. An error changes nothing. */
ek_status ek_pose_graph_close(ek_pose_graph *graph, const ek_loop_edge *loop);

/* Begin a run from graph->pose with the weights of the loops; poses that are added later do not take part.
 * EK_OUT_OF_RANGE: settings out of range. `restart` 0 goes on from graph->moved of the last run. */
ek_status ek_pose_graph_begin(ek_pose_graph *graph, const ek_solver_settings *settings, int restart);

/* Begin to compute graph->solver.predicted: the covariance of the residual of an edge between two poses as the graph
 * predicts it, in the frame of the second pose, with all loops at weight 1. EK_OUT_OF_RANGE: not two poses in ascending
 * order. */
ek_status ek_pose_graph_predict(ek_pose_graph *graph, uint32_t first, uint32_t second);

/* Go on with a run while work is left. 1: the run has ended. A call without work left does nothing. */
int ek_pose_graph_work(ek_pose_graph *graph, ek_work *work);

/* Take the poses of the run over; poses that were added since move with the last one of the run. */
void ek_pose_graph_commit(ek_pose_graph *graph);

/* Chi-square of a loop at given poses. */
ek_real ek_pose_graph_chi(const ek_loop_edge *loop, const ek_pose *pose);

#ifdef __cplusplus
}
#endif
#endif

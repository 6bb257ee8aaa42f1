/* icp.h - point-to-point ICP of the plane with one-to-one pairs in closed form (the paper, equations 2 to 9).
 *
 * The same meaning as the NumPy twin evalkit_baselines/paper/icp.py. Nearest neighbours are exact; a point is only asked
 * for again when it has moved so far that another target point may have come nearer (triangle inequality).
 */
#ifndef EK_ICP_H
#define EK_ICP_H

#include "ek/index.h"
#include "ek/se2.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What the stop rule watches: mean distance (m), mean squared distance (m^2), or its root (m). */
typedef enum { EK_ERROR_MEAN = 0, EK_ERROR_MEAN_SQUARED = 1, EK_ERROR_RMSE = 2 } ek_error_measure;

typedef struct {
    int32_t max_iterations;     /* 1 or more */
    int32_t min_pairs;          /* 2 or more; with fewer the guess is the answer */
    ek_real epsilon;            /* stop when the error changes by less; 0 or more */
    ek_real max_correspondence; /* m; pairs as far apart or farther are dropped; 0 keeps all */
    ek_error_measure error;
    int32_t error_before;       /* 0: error of the same pairs after the step; 1: before it */
    int32_t one_to_one;         /* 1: of several source points that share a target point only the closest counts */
} ek_icp_parameters;

/* A registration's answer. Not converging is an answer, not an error. */
typedef struct {
    ek_pose target_from_source;
    int32_t converged;
    int32_t iterations;
    int32_t inliers; /* pairs it stands on */
    ek_real error;   /* m (root of the mean square for EK_ERROR_MEAN_SQUARED); nan with too few pairs */
    uint32_t asked;  /* nearest-neighbour queries made; the rest were proven unchanged */
} ek_match;

/* One iteration as a trace hook sees it. The arrays live until the hook returns. */
typedef struct {
    int32_t iteration; /* from 1 */
    int32_t inliers;
    ek_real error;     /* in the unit of the stop rule */
    ek_pose step;      /* in the target's frame */
    ek_pose target_from_source;     /* after the step */
    const uint32_t *source, *target; /* indices of the pairs, ascending by source */
} ek_icp_iteration;

typedef void (*ek_icp_trace)(void *context, const ek_icp_iteration *iteration);

/* Working memory for one registration at a time. */
typedef struct {
    size_t capacity, targets;
    ek_real *px, *py;       /* source points */
    ek_real *mx, *my;       /* the same, moved into the target's frame */
    ek_real *tx, *ty;       /* their nearest target points, EK_FAR where there is none */
    ek_real *ax, *ay;       /* where they stood when the index was asked */
    ek_real *others;        /* no other target point was nearer than this then */
    ek_real *distance;      /* to the nearest target point */
    ek_real *slack;         /* not positive: must ask again */
    ek_real *weight;        /* 1: a pair, 0: not */
    uint32_t *nearest;      /* slot in the index, or `targets` */
    uint32_t *stale;        /* the points to ask for */
    uint32_t *owner;        /* slot -> the source point that holds it, if nearest[owner] is that slot */
    uint32_t *pair_source, *pair_target;
} ek_icp;

#define ek_icp_default EK_NAME(icp_default)
#define ek_icp_check EK_NAME(icp_check)
#define ek_icp_lay_out EK_NAME(icp_lay_out)
#define ek_icp_register EK_NAME(icp_register)

/* The paper's values: 40 iterations, epsilon 1e-4 on the mean distance after the step, one-to-one, 0.5 m, 3 pairs. */
ek_icp_parameters ek_icp_default(void);

/* EK_OUT_OF_RANGE when a parameter is outside its range or not finite, else EK_OK. */
ek_status ek_icp_check(const ek_icp_parameters *parameters);

/* Lays working memory out for up to `capacity` source points and indices of up to `targets` points.
 * EK_OUT_OF_RANGE: a capacity is 0 or above 2^30. */
ek_status ek_icp_lay_out(ek_icp *icp, ek_arena *arena, size_t capacity, size_t targets);

/* The motion target_from_source, starting from `guess`: source_xy holds count pairs x y (m). trace may be NULL.
 * Stateless: the same arguments give the same answer. An empty index gives the guess, not converged, 0 pairs.
 * EK_NO_POINTS, EK_TOO_MANY_POINTS, EK_NOT_FINITE (points or guess), EK_OUT_OF_RANGE (parameters, a
 * coordinate beyond EK_LARGEST, or an index larger than `targets`). After an error *match is untouched. */
ek_status ek_icp_register(ek_icp *icp, const ek_index *target, const ek_real *source_xy, size_t count, ek_pose guess,
                          const ek_icp_parameters *parameters, ek_icp_trace trace, void *context, ek_match *match);

#ifdef __cplusplus
}
#endif
#endif

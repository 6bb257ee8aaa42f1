/* icp.h - ICP in the plane: one-to-one pairs, closed-form step (paper, equations 2 to 9); or distances to lines.
 *
 * The default parameters are set in ek_icp_default (icp.c); they equal those of evalkit_baselines/paper/icp.py.
 * Computes the same as the NumPy reference evalkit_baselines/paper/icp.py. Nearest neighbours are exact. A neighbour is
 * searched again only if the point has moved so far that another target point may be nearer (triangle inequality).
 */
#ifndef EK_ICP_H
#define EK_ICP_H

#include "ek/index.h"
#include "ek/se2.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Error of the stop rule: mean distance (m), mean squared distance (m^2), or its root (m). */
typedef enum { EK_ERROR_MEAN = 0, EK_ERROR_MEAN_SQUARED = 1, EK_ERROR_RMSE = 2 } ek_error_measure;

/* Distance that a step minimises: to the target point, or to the line through it. */
typedef enum { EK_METRIC_POINT = 0, EK_METRIC_LINE = 1 } ek_metric;

typedef struct {
    int32_t max_iterations;     /* 1 or more */
    int32_t min_pairs;          /* 2 or more; with fewer pairs the guess is returned */
    ek_real epsilon;            /* stop if the error changes by less; 0 or more */
    ek_real max_correspondence; /* m; pairs at this distance or farther are dropped; 0 keeps all */
    ek_error_measure error;
    int32_t error_before;       /* 0: error of the pairs after the step; 1: before it */
    int32_t one_to_one;         /* 1: of several source points with the same target point only the closest is kept */
    ek_metric metric;           /* EK_METRIC_LINE needs ek_icp_init_lines and the normals of the target */
    ek_real cauchy;             /* scale of the Cauchy weight of EK_METRIC_LINE (m); 0: equal weights */
    int32_t share_noise;        /* 1: with EK_METRIC_LINE, each of c pairs with the same target point, which is the mean
                                   of n points (`support` of the index), weighs 1 / (1 + c / n), n at most 20 */
    ek_real origin_x, origin_y; /* m: where the source points were seen from, in their frame; nan: unknown. With EK_METRIC_LINE,
                                   a pair whose target point was seen from the other side of its line (`seen_from` of the
                                   index) is none */
} ek_icp_parameters;

/* Result of a registration. Not converging is a result, not an error. */
typedef struct {
    ek_pose target_from_source;
    int32_t converged;
    int32_t iterations;
    int32_t inliers; /* number of pairs used */
    ek_real error;   /* m (root of the mean square for EK_ERROR_MEAN_SQUARED); nan with too few pairs */
    uint32_t queries; /* nearest-neighbour searches made; the other neighbours were proven unchanged */
} ek_match;

/* One iteration, as passed to the trace function. The arrays are valid until it returns. */
typedef struct {
    int32_t iteration; /* from 1 */
    int32_t inliers;
    ek_real error;     /* in the unit of the stop rule */
    ek_pose step;      /* in the target's frame */
    ek_pose target_from_source;     /* after the step */
    const uint32_t *source, *target; /* indices of the pairs, ascending by source */
} ek_icp_iteration;

typedef void (*ek_icp_trace)(void *context, const ek_icp_iteration *iteration);

/* Working memory of one registration. */
typedef struct {
    size_t capacity, targets;
    int wide;               /* what the processor has: ek_wide() (wide.h) */
    int grouped;            /* 1: points that lie beside each other are searched together (nearby.h) */
    ek_real *px, *py;       /* source points */
    ek_real *mx, *my;       /* source points in the target's frame */
    ek_real *tx, *ty;       /* nearest target points; EK_FAR if there is none */
    ek_real *ax, *ay;       /* positions at the last search */
    ek_real *others;        /* lower bound on the distance to any other target point at the last search */
    ek_real *distance;      /* to the nearest target point */
    ek_real *slack;         /* not positive: search again; afterwards, with candidates, the square of the distance */
    ek_real *weight;        /* 1: a pair, 0: not */
    ek_real *nx, *ny;       /* normals of the nearest target points; NULL without ek_icp_init_lines */
    ek_real *across;        /* distance to their lines */
    ek_real *facing;        /* 1: seen from the side of the target points' lines that these were seen from, or either; 0: not */
    ek_real viewer_x, viewer_y; /* where the source points were seen from, in the target's frame at the guess (m) */
    ek_real *share;         /* weight of a pair among those with its target point; 0: no pair */
    uint32_t *lined;        /* with candidates: slot whose normal is stored, or `targets` */
    ek_real *cx, *cy;       /* candidates: EK_BLOCK target points that can be nearest; NULL without memory for them */
    ek_real *choice;        /* which of them is nearest */
    uint32_t *slots;        /* their slots in the index; 0 and EK_FAR away or farther: none */
    uint32_t *nearest;      /* slot in the index, or `targets` */
    uint32_t *stale;        /* points to search for */
    uint32_t *owner;        /* slot (and one for none) -> the closest source point; then the number of pairs */
    uint32_t *pair_source, *pair_target; /* pairs of a trace; pair_source also: blocks of a table to search in */
} ek_icp;

#define ek_icp_default EK_NAME(icp_default)
#define ek_icp_check EK_NAME(icp_check)
#define ek_icp_init EK_NAME(icp_init)
#define ek_icp_init_lines EK_NAME(icp_init_lines)
#define ek_icp_init_table EK_NAME(icp_init_table)
#define ek_icp_register EK_NAME(icp_register)

/* Default parameters: 40 iterations, epsilon 1e-4 on the mean distance after the step, one-to-one, 0.3 m, 3 pairs. */
ek_icp_parameters ek_icp_default(void);

/* Check parameters: EK_OUT_OF_RANGE if one is outside its range or not finite, otherwise EK_OK. */
ek_status ek_icp_check(const ek_icp_parameters *parameters);

/* Initialise working memory for up to `capacity` source points and indices of up to `targets` points; where EK_GROUPED
 * (wide.h), with memory for candidates. EK_OUT_OF_RANGE: a capacity is 0 or above 2^30. */
ek_status ek_icp_init(ek_icp *icp, ek_arena *arena, size_t capacity, size_t targets);

/* Initialise the memory that EK_METRIC_LINE needs in addition. */
ek_status ek_icp_init_lines(ek_icp *icp, ek_arena *arena);

/* Initialise the memory for candidates, if ek_icp_init has not. A target with a table (table.h) needs it. */
ek_status ek_icp_init_table(ek_icp *icp, ek_arena *arena);

/* Compute target_from_source, starting from `guess`. source_xy holds count pairs x y (m); trace may be NULL.
 * Stateless: the same arguments give the same result. An empty index gives the guess, not converged, 0 pairs.
 * EK_NO_POINTS, EK_TOO_MANY_POINTS, EK_NOT_FINITE (points or guess), EK_OUT_OF_RANGE (parameters, a coordinate larger
 * than EK_MAX_COORDINATE, or an index larger than `targets`), EK_NULL_POINTER (also: EK_METRIC_LINE without
 * ek_icp_init_lines or without normals of the target, and a target with a table without ek_icp_init_table). An error
 * leaves *match unchanged. */
ek_status ek_icp_register(ek_icp *icp, const ek_index *target, const ek_real *source_xy, size_t count, ek_pose guess,
                          const ek_icp_parameters *parameters, ek_icp_trace trace, void *context, ek_match *match);

#ifdef __cplusplus
}
#endif
#endif

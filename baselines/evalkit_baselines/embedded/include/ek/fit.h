/* fit.h - least-squares motions of pairs: points to points (paper, equations 3 and 4), and points to lines. */
#ifndef EK_FIT_H
#define EK_FIT_H

#include "ek/se2.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Pairs of source and target points in the target's frame; arrays of `padded` entries, a multiple of EK_LANES. */
typedef struct {
    size_t padded;
    const ek_real *x, *y;   /* source points (m) */
    const ek_real *tx, *ty; /* target points (m) */
    const ek_real *nx, *ny; /* unit normals of the lines through the target points; for ek_fit_lines only */
    const ek_real *weight;  /* 1: a pair, 0: not */
    const ek_real *share;   /* NULL, or the weights of the pairs for ek_fit_lines, 0: no pair */
    int wide;               /* what the processor has: ek_wide() (wide.h); the sums are the same */
} ek_pairs;

#define ek_fit_count EK_NAME(fit_count)
#define ek_fit_sum EK_NAME(fit_sum)
#define ek_fit_points EK_NAME(fit_points)
#define ek_fit_lines EK_NAME(fit_lines)

/* Sum of the weights: the number of pairs. */
ek_real ek_fit_count(const ek_real *weight, size_t padded, int wide);

/* Weighted sum of distances, or of their squares, in lanes like the other sums. */
ek_real ek_fit_sum(const ek_real *weight, const ek_real *distance, size_t padded, int squared, int wide);

/* The motion that minimises the squared distances of the pairs; the angle cannot be a reflection. Sums are taken
 * relative to (ox, oy), which should be near the points. */
ek_pose ek_fit_points(const ek_pairs *pairs, ek_real ox, ek_real oy);

/* The motion that minimises the squared distances of the source points to the lines, linearised once in theta. Pairs
 * weigh 1 / (1 + (distance / cauchy)^2), or the same where cauchy (m) is 0, each multiplied by its share. Nothing moves in
 * a direction that the lines do not constrain. Sums are taken relative to (ox, oy). */
ek_pose ek_fit_lines(const ek_pairs *pairs, ek_real cauchy, ek_real ox, ek_real oy);

#ifdef __cplusplus
}
#endif
#endif

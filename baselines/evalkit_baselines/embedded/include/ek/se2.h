/* se2.h - rigid motions of the plane.
 *
 * A motion named a_from_b takes coordinates in frame b to frame a; names cancel like dominoes:
 * a_from_c = ek_se2_compose(a_from_b, b_from_c).
 */
#ifndef EK_SE2_H
#define EK_SE2_H

#include "ek/real.h"

#ifdef __cplusplus
extern "C" {
#endif

/* x, y in metres, theta in radians, counter-clockwise, within [-pi, pi) when it comes out of this module. */
typedef struct {
    ek_real x, y, theta;
} ek_pose;

#define ek_se2_wrap EK_NAME(se2_wrap)
#define ek_se2_compose EK_NAME(se2_compose)
#define ek_se2_inverse EK_NAME(se2_inverse)
#define ek_se2_between EK_NAME(se2_between)
#define ek_se2_fraction EK_NAME(se2_fraction)
#define ek_se2_finite EK_NAME(se2_finite)

/* The same angle in [-pi, pi) (rad). */
ek_real ek_se2_wrap(ek_real theta);

/* a_from_c. */
ek_pose ek_se2_compose(ek_pose a_from_b, ek_pose b_from_c);

/* b_from_a. */
ek_pose ek_se2_inverse(ek_pose a_from_b);

/* a_from_b of two frames known in a third. */
ek_pose ek_se2_between(ek_pose w_from_a, ek_pose w_from_b);

/* The part `share` (0 to 1) of one motion along its constant-velocity arc (the exponential of a share of its
 * logarithm). */
ek_pose ek_se2_fraction(ek_pose a_from_b, ek_real share);

/* 1 when all three numbers are finite, else 0. */
int ek_se2_finite(ek_pose pose);

#ifdef __cplusplus
}
#endif
#endif

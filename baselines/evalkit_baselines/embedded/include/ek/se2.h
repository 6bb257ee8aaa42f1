/* se2.h - rigid motions of the plane.
 *
 * a_from_b transforms coordinates in frame b to frame a: a_from_c = ek_se2_compose(a_from_b, b_from_c).
 */
#ifndef EK_SE2_H
#define EK_SE2_H

#include "ek/real.h"

#ifdef __cplusplus
extern "C" {
#endif

/* x, y in metres; theta in radians, counter-clockwise. Functions of this module return theta in [-pi, pi). */
typedef struct {
    ek_real x, y, theta;
} ek_pose;

#define ek_se2_wrap EK_NAME(se2_wrap)
#define ek_se2_compose EK_NAME(se2_compose)
#define ek_se2_inverse EK_NAME(se2_inverse)
#define ek_se2_between EK_NAME(se2_between)
#define ek_se2_fraction EK_NAME(se2_fraction)
#define ek_se2_transform EK_NAME(se2_transform)
#define ek_se2_is_finite EK_NAME(se2_is_finite)

/* Wrap an angle to [-pi, pi) (rad). */
ek_real ek_se2_wrap(ek_real theta);

/* Compose two motions: a_from_c. */
ek_pose ek_se2_compose(ek_pose a_from_b, ek_pose b_from_c);

/* Invert a motion: b_from_a. */
ek_pose ek_se2_inverse(ek_pose a_from_b);

/* a_from_b of two frames a and b given in a third frame w. */
ek_pose ek_se2_between(ek_pose w_from_a, ek_pose w_from_b);

/* The fraction `share` (0 to 1) of a motion along its constant-velocity arc: exp(share * log(a_from_b)). */
ek_pose ek_se2_fraction(ek_pose a_from_b, ek_real share);

/* Transform `count` pairs x y (m) by a motion; `to` may be `from`. */
void ek_se2_transform(ek_pose to_from_from, const ek_real *from, size_t count, ek_real *to);

/* 1 if all three numbers are finite. */
int ek_se2_is_finite(ek_pose pose);

#ifdef __cplusplus
}
#endif
#endif

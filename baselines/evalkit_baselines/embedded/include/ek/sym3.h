/* sym3.h - symmetric 3 x 3 matrices in the order x, y, theta: covariances of motions and their inverses. */
#ifndef EK_SYM3_H
#define EK_SYM3_H

#include "ek/real.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    ek_real xx, xy, xt, yy, yt, tt;
} ek_sym3;

#define ek_sym3_inverse EK_NAME(sym3_inverse)
#define ek_sym3_quadratic EK_NAME(sym3_quadratic)
#define ek_sym3_congruence EK_NAME(sym3_congruence)
#define ek_sym3_sum EK_NAME(sym3_sum)
#define ek_sym3_factor EK_NAME(sym3_factor)

/* Invert a positive definite matrix; 0 if it is not, and *inverse is then unchanged. */
int ek_sym3_inverse(const ek_sym3 *matrix, ek_sym3 *inverse);

/* v^T A v. */
ek_real ek_sym3_quadratic(const ek_sym3 *a, const ek_real v[3]);

/* B A B^T for a 3 x 3 matrix B, row-major. */
ek_sym3 ek_sym3_congruence(const ek_real b[9], const ek_sym3 *a);

/* A + share * B. */
ek_sym3 ek_sym3_sum(const ek_sym3 *a, const ek_sym3 *b, ek_real share);

/* Lower triangular factor, row-major: A = L L^T. 0 if A is not positive definite. */
int ek_sym3_factor(const ek_sym3 *a, ek_real lower[9]);

#ifdef __cplusplus
}
#endif
#endif

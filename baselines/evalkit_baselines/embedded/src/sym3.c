#include "ek/sym3.h"

int ek_sym3_factor(const ek_sym3 *a, ek_real lower[9])
{
    const ek_real p = EK_SQRT(a->xx > EK_R(0.0) ? a->xx : EK_R(0.0));
    const ek_real q = p > EK_R(0.0) ? a->xy / p : EK_R(0.0), r = p > EK_R(0.0) ? a->xt / p : EK_R(0.0);
    const ek_real yy = a->yy - q * q, s = EK_SQRT(yy > EK_R(0.0) ? yy : EK_R(0.0));
    const ek_real t = s > EK_R(0.0) ? (a->yt - q * r) / s : EK_R(0.0), tt = a->tt - r * r - t * t;
    if (!(p > EK_R(0.0) && s > EK_R(0.0) && tt > EK_R(0.0) && isfinite(p + s + tt))) {
        return 0;
    }
    lower[0] = p;
    lower[3] = q;
    lower[4] = s;
    lower[6] = r;
    lower[7] = t;
    lower[8] = EK_SQRT(tt);
    lower[1] = lower[2] = lower[5] = EK_R(0.0);
    return 1;
}

int ek_sym3_inverse(const ek_sym3 *matrix, ek_sym3 *inverse)
{
    ek_real l[9];
    if (!ek_sym3_factor(matrix, l)) {
        return 0;
    }
    /* inverse of the factor, then its square */
    const ek_real a = EK_R(1.0) / l[0], c = EK_R(1.0) / l[4], f = EK_R(1.0) / l[8];
    const ek_real b = -l[3] * a * c, e = -l[7] * c * f, d = -(l[6] * a + l[7] * b) * f;
    inverse->xx = a * a + b * b + d * d;
    inverse->xy = b * c + d * e;
    inverse->xt = d * f;
    inverse->yy = c * c + e * e;
    inverse->yt = e * f;
    inverse->tt = f * f;
    return 1;
}

ek_real ek_sym3_quadratic(const ek_sym3 *a, const ek_real v[3])
{
    return v[0] * (a->xx * v[0] + a->xy * v[1] + a->xt * v[2]) + v[1] * (a->xy * v[0] + a->yy * v[1] + a->yt * v[2]) +
           v[2] * (a->xt * v[0] + a->yt * v[1] + a->tt * v[2]);
}

ek_sym3 ek_sym3_congruence(const ek_real b[9], const ek_sym3 *a)
{
    ek_real m[9];
    for (size_t i = 0; i < 9u; i += 3u) {
        m[i] = b[i] * a->xx + b[i + 1u] * a->xy + b[i + 2u] * a->xt;
        m[i + 1u] = b[i] * a->xy + b[i + 1u] * a->yy + b[i + 2u] * a->yt;
        m[i + 2u] = b[i] * a->xt + b[i + 1u] * a->yt + b[i + 2u] * a->tt;
    }
    const ek_sym3 product = {m[0] * b[0] + m[1] * b[1] + m[2] * b[2], m[0] * b[3] + m[1] * b[4] + m[2] * b[5],
                             m[0] * b[6] + m[1] * b[7] + m[2] * b[8], m[3] * b[3] + m[4] * b[4] + m[5] * b[5],
                             m[3] * b[6] + m[4] * b[7] + m[5] * b[8], m[6] * b[6] + m[7] * b[7] + m[8] * b[8]};
    return product;
}

ek_sym3 ek_sym3_sum(const ek_sym3 *a, const ek_sym3 *b, ek_real share)
{
    const ek_sym3 sum = {a->xx + share * b->xx, a->xy + share * b->xy, a->xt + share * b->xt,
                         a->yy + share * b->yy, a->yt + share * b->yt, a->tt + share * b->tt};
    return sum;
}

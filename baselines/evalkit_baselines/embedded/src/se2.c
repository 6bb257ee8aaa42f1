#include "ek/se2.h"

ek_real ek_se2_wrap(ek_real theta)
{
    const ek_real turn = EK_R(2.0) * EK_PI;
    ek_real wrapped = theta - turn * EK_FLOOR((theta + EK_PI) / turn);
    if (wrapped >= EK_PI) {
        wrapped -= turn;
    }
    return wrapped < -EK_PI ? -EK_PI : wrapped;
}

ek_pose ek_se2_compose(ek_pose a_from_b, ek_pose b_from_c)
{
    const ek_real c = EK_COS(a_from_b.theta), s = EK_SIN(a_from_b.theta);
    ek_pose a_from_c;
    a_from_c.x = a_from_b.x + c * b_from_c.x - s * b_from_c.y;
    a_from_c.y = a_from_b.y + s * b_from_c.x + c * b_from_c.y;
    a_from_c.theta = ek_se2_wrap(a_from_b.theta + b_from_c.theta);
    return a_from_c;
}

ek_pose ek_se2_inverse(ek_pose a_from_b)
{
    const ek_real c = EK_COS(a_from_b.theta), s = EK_SIN(a_from_b.theta);
    ek_pose b_from_a;
    b_from_a.x = -c * a_from_b.x - s * a_from_b.y;
    b_from_a.y = s * a_from_b.x - c * a_from_b.y;
    b_from_a.theta = ek_se2_wrap(-a_from_b.theta);
    return b_from_a;
}

ek_pose ek_se2_between(ek_pose w_from_a, ek_pose w_from_b)
{
    return ek_se2_compose(ek_se2_inverse(w_from_a), w_from_b);
}

ek_pose ek_se2_fraction(ek_pose a_from_b, ek_real share)
{
    const ek_real theta = a_from_b.theta, angle = share * theta;
    ek_pose part;
    if (EK_FABS(theta) < EK_R(1e-9)) {
        part.x = share * a_from_b.x;
        part.y = share * a_from_b.y;
        part.theta = angle;
        return part;
    }
    /* logarithm: V^-1 (x, y) with V = [[sin, cos - 1], [1 - cos, sin]] / theta */
    const ek_real half = EK_R(0.5) * theta, cot = half / EK_TAN(half);
    const ek_real vx = cot * a_from_b.x + half * a_from_b.y, vy = -half * a_from_b.x + cot * a_from_b.y;
    /* 1 - cos as 2 sin^2 of the half: small angles keep their digits in a float build */
    const ek_real half_sine = EK_SIN(EK_R(0.5) * angle);
    const ek_real s = EK_SIN(angle) / theta, c1 = EK_R(2.0) * half_sine * half_sine / theta;
    part.x = s * vx - c1 * vy;
    part.y = c1 * vx + s * vy;
    part.theta = ek_se2_wrap(angle);
    return part;
}

void ek_se2_transform(ek_pose to_from_from, const ek_real *from, size_t count, ek_real *to)
{
    const ek_real c = EK_COS(to_from_from.theta), s = EK_SIN(to_from_from.theta);
    for (size_t i = 0; i < 2u * count; i += 2u) {
        const ek_real x = from[i], y = from[i + 1u];
        to[i] = c * x - s * y + to_from_from.x;
        to[i + 1u] = s * x + c * y + to_from_from.y;
    }
}

int ek_se2_is_finite(ek_pose pose)
{
    return isfinite(pose.x) && isfinite(pose.y) && isfinite(pose.theta);
}

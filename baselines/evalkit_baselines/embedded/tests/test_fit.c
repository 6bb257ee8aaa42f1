#include "check.h"
#include "ek/fit.h"

#define COUNT 40u

static ek_real x[COUNT], y[COUNT], tx[COUNT], ty[COUNT], nx[COUNT], ny[COUNT], weight[COUNT], share[COUNT];
static ek_pairs pairs = {COUNT, x, y, tx, ty, nx, ny, weight, NULL, 0};

/* Points on two walls as targets, moved by the inverse of a motion as sources. */
static void fill(ek_pose motion, int walls)
{
    uint64_t seed = 5u;
    const ek_pose inverse = ek_se2_inverse(motion);
    const ek_real c = EK_COS(inverse.theta), s = EK_SIN(inverse.theta);
    for (size_t k = 0; k < COUNT; k++) {
        const int flat = walls == 1 || k % 2u;
        const ek_real along = uniform(&seed, -3.0, 3.0);
        tx[k] = flat ? along : EK_R(2.0);
        ty[k] = flat ? EK_R(1.0) : along;
        nx[k] = flat ? EK_R(0.0) : EK_R(-1.0);
        ny[k] = flat ? EK_R(1.0) : EK_R(0.0);
        x[k] = c * tx[k] - s * ty[k] + inverse.x;
        y[k] = s * tx[k] + c * ty[k] + inverse.y;
        weight[k] = EK_R(1.0);
    }
}

static void check_motion(ek_pose found, ek_pose expected, double tolerance)
{
    CHECK_NEAR(found.x, expected.x, tolerance);
    CHECK_NEAR(found.y, expected.y, tolerance);
    CHECK_NEAR(found.theta, expected.theta, tolerance);
}

static void exact_pairs_give_the_motion(void)
{
    const ek_pose motion = {EK_R(0.3), EK_R(-0.2), EK_R(0.4)}, shift = {EK_R(0.03), EK_R(-0.02), EK_R(0.0)};
    fill(motion, 2);
    check_motion(ek_fit_points(&pairs, EK_R(1.0), EK_R(2.0)), motion, 10.0 * TOLERANCE);
    fill(shift, 2); /* without a rotation the lines need no second step either */
    check_motion(ek_fit_lines(&pairs, EK_R(0.0), EK_R(1.0), EK_R(2.0)), shift, 10.0 * TOLERANCE);
}

/* Walls that face 30, 100 and 250 degrees: none of the sums of the equations vanishes. */
static void oblique_walls_give_the_motion(void)
{
    static const double facing[] = {30.0, 100.0, 250.0};
    const ek_pose shift = {EK_R(0.03), EK_R(-0.02), EK_R(0.0)};
    for (size_t k = 0; k < COUNT; k++) {
        const double angle = facing[k % 3u] * (double)EK_PI / 180.0, c = cos(angle), s = sin(angle);
        const double along = 0.3 * (double)k - 5.0;
        tx[k] = EK_R(2.0 * c - along * s);
        ty[k] = EK_R(2.0 * s + along * c);
        nx[k] = EK_R(c);
        ny[k] = EK_R(s);
        x[k] = tx[k] - shift.x;
        y[k] = ty[k] - shift.y;
        weight[k] = EK_R(1.0);
    }
    check_motion(ek_fit_lines(&pairs, EK_R(0.0), EK_R(1.0), EK_R(2.0)), shift, 10.0 * TOLERANCE);
}

static void along_a_single_wall_nothing_moves(void)
{
    const ek_pose shift = {EK_R(0.5), EK_R(0.04), EK_R(0.0)}, across = {EK_R(0.0), EK_R(0.04), EK_R(0.0)};
    fill(shift, 1);
    check_motion(ek_fit_lines(&pairs, EK_R(0.1), EK_R(0.0), EK_R(0.0)), across, 10.0 * TOLERANCE);
}

/* One wall at distances 0, 0, 0 and 0.3 m: equal weights move a quarter of it, Cauchy weights of 0.1 m less:
 * 0.1 * 0.3 / (3 + 0.1); with three times the share 3 * 0.1 * 0.3 / (3 + 3 * 0.1). Points at the same place, so that no
 * rotation helps. */
static void far_pairs_weigh_less(void)
{
    for (size_t k = 0; k < COUNT; k++) {
        x[k] = y[k] = tx[k] = nx[k] = EK_R(0.0);
        ty[k] = k == 3u ? EK_R(0.3) : EK_R(0.0);
        ny[k] = EK_R(1.0);
        weight[k] = k < 4u ? EK_R(1.0) : EK_R(0.0);
        share[k] = k == 3u ? EK_R(0.75) : weight[k] * EK_R(0.25);
    }
    const ek_pose shared = {EK_R(0.0), EK_R(0.09 / 3.3), EK_R(0.0)};
    const ek_pose equal = {EK_R(0.0), EK_R(0.075), EK_R(0.0)}, robust = {EK_R(0.0), EK_R(0.03 / 3.1), EK_R(0.0)};
    check_motion(ek_fit_lines(&pairs, EK_R(0.0), EK_R(0.0), EK_R(0.0)), equal, TOLERANCE);
    check_motion(ek_fit_lines(&pairs, EK_R(0.1), EK_R(0.0), EK_R(0.0)), robust, TOLERANCE);
    pairs.share = share;
    check_motion(ek_fit_lines(&pairs, EK_R(0.1), EK_R(0.0), EK_R(0.0)), shared, TOLERANCE);
    pairs.share = NULL;
}

int main(void)
{
    exact_pairs_give_the_motion();
    oblique_walls_give_the_motion();
    along_a_single_wall_nothing_moves();
    far_pairs_weigh_less();
    return verdict();
}

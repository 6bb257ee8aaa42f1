#include "check.h"
#include "ek/se2.h"

static void check_pose(ek_pose found, double x, double y, double theta)
{
    CHECK_NEAR(found.x, x, TOLERANCE);
    CHECK_NEAR(found.y, y, TOLERANCE);
    CHECK_NEAR(found.theta, theta, TOLERANCE);
}

/* A quarter of a turn and a step, in place, too. */
static void points_are_turned_and_moved(void)
{
    const ek_pose motion = {EK_R(3.0), EK_R(-1.0), EK_R(0.5) * EK_PI};
    ek_real points[] = {EK_R(2.0), EK_R(1.0), EK_R(0.0), EK_R(5.0)}, moved[4];
    ek_se2_transform(motion, points, 2u, moved);
    ek_se2_transform(motion, points, 1u, points);
    const double expected[] = {2.0, 1.0, -2.0, -1.0};
    for (size_t k = 0; k < 4u; k++) {
        CHECK_NEAR(moved[k], expected[k], 1e-6);
        CHECK_NEAR(points[k], k < 2u ? expected[k] : k == 2u ? 0.0 : 5.0, 1e-6);
    }
}

int main(void)
{
    points_are_turned_and_moved();
    const ek_pose quarter = {EK_R(1.0), EK_R(0.0), EK_PI / EK_R(2.0)}, ahead = {EK_R(1.0), EK_R(0.0), EK_R(0.0)};
    check_pose(ek_se2_compose(quarter, ahead), 1.0, 1.0, (double)EK_PI / 2.0);
    check_pose(ek_se2_compose(quarter, ek_se2_inverse(quarter)), 0.0, 0.0, 0.0);
    check_pose(ek_se2_between(quarter, ek_se2_compose(quarter, ahead)), 1.0, 0.0, 0.0);

    CHECK_NEAR(ek_se2_wrap(EK_R(3.0) * EK_PI / EK_R(2.0)), -(double)EK_PI / 2.0, TOLERANCE);
    CHECK(ek_se2_wrap(EK_PI) < EK_R(0.0) && ek_se2_wrap(-EK_PI) >= -EK_PI && ek_se2_wrap(EK_R(1e5)) < EK_PI);

    /* half of a quarter circle of radius 1 ends at 45 degrees */
    const ek_pose arc = {EK_R(1.0), EK_R(1.0), EK_PI / EK_R(2.0)};
    check_pose(ek_se2_fraction(arc, EK_R(0.5)), sin(0.25 * (double)EK_PI), 1.0 - cos(0.25 * (double)EK_PI),
               (double)EK_PI / 4.0);
    check_pose(ek_se2_fraction(ahead, EK_R(0.25)), 0.25, 0.0, 0.0);
    check_pose(ek_se2_fraction(arc, EK_R(1.0)), 1.0, 1.0, (double)EK_PI / 2.0);

    for (int k = -40; k <= 40; k++) { /* next to every odd multiple of pi: within [-pi, pi) whatever the rounding */
        for (int ulp = -3; ulp <= 3; ulp++) {
            const ek_real turn = EK_PI * (ek_real)(2 * k + 1), wrapped = ek_se2_wrap(turn * (EK_R(1.0) + EK_EPSILON * (ek_real)ulp));
            CHECK(wrapped >= -EK_PI && wrapped < EK_PI && EK_FABS(wrapped) > EK_R(3.1));
        }
    }
    /* an odd multiple of pi, so large that in double precision its turns are rounded to one too few */
    const ek_real huge = ek_se2_wrap(EK_R(0x1.1782d4fcdd0f9p+42));
    CHECK(huge >= -EK_PI && huge < EK_PI);
    const ek_pose without_turn = {EK_R(0.0), EK_R(0.0), (ek_real)NAN}, without_x = {(ek_real)NAN, EK_R(0.0), EK_R(0.0)};
    CHECK(!ek_se2_is_finite(without_turn) && !ek_se2_is_finite(without_x));
    const ek_pose broken = {EK_R(0.0), (ek_real)NAN, EK_R(0.0)};
    CHECK(ek_se2_is_finite(arc) && !ek_se2_is_finite(broken));
    return verdict();
}

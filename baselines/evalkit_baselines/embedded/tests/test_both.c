/* Both builds link into one program: this file is double, test_both_float.c is float. */
#include "check.h"
#include "ek/se2.h"

double half_turn_in_float(void);

int main(void)
{
    const ek_pose quarter = {1.0, 0.0, EK_PI / 2.0};
    CHECK(sizeof(ek_real) == sizeof(double));
    CHECK_NEAR(ek_se2_compose(quarter, quarter).theta, half_turn_in_float(), 1e-6);
    return verdict();
}

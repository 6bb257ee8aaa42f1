#include "ek/se2.h"

double half_turn_in_float(void);

double half_turn_in_float(void)
{
    const ek_pose quarter = {1.0f, 0.0f, EK_PI / 2.0f};
    return (double)ek_se2_compose(quarter, quarter).theta;
}

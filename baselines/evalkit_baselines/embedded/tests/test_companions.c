#include "check.h"
#include "ek/companions.h"

#define BEAMS 360u
#define LOW EK_R(0.1)
#define HIGH EK_R(12.0)
#define PI 3.14159265358979323846

static ek_real ranges[BEAMS], angles[BEAMS];
static ek_view views[3];
static ek_company company;

static int is_behind(size_t beam) /* beam k is k - 180 deg from the front */
{
    return beam <= 12u || beam >= 348u;
}

/* Seen `x` m along the middle of a corridor 2 m wide and 40 m long; something `behind` m behind it (0: nothing). */
static void see(double x, double behind)
{
    for (size_t k = 0; k < BEAMS; k++) {
        const double angle = ((double)k - 180.0) * PI / 180.0, c = cos(angle), s = sin(angle);
        const double side = 1.0 / fmax(fabs(s), 1e-9), end = (c > 0.0 ? 20.0 - x : 20.0 + x) / fmax(fabs(c), 1e-9);
        const double seen = is_behind(k) && behind > 0.0 ? behind : fmin(side, end);
        angles[k] = EK_R(angle);
        ranges[k] = seen < 12.0 ? EK_R(seen) : (ek_real)INFINITY;
    }
}

static size_t drop(double x)
{
    const ek_pose odom_from_sensor = {EK_R(x), EK_R(0.0), EK_R(0.0)};
    return ek_drop_companions(views, &company, ranges, angles, BEAMS, LOW, HIGH, odom_from_sensor);
}

/* What is 1.2 m behind is left out from half a metre on, its 25 beams alone. */
static void a_companion_is_left_out_and_the_walls_stay(void)
{
    memset(&company, 0, sizeof company);
    for (size_t at = 0; at < 40u; at++) {
        see(0.101 * (double)at, 1.2);
        CHECK(drop(0.101 * (double)at) == (at < 5u ? 0u : 25u));
        for (size_t k = 0; k < BEAMS; k++) {
            CHECK(!isnan(ranges[k]) == !(at >= 5u && is_behind(k)));
        }
    }
    CHECK(company.scans == 10u && company.older > 0u && company.newer > 0u && company.older != company.newer);
}

/* One that comes later, once the mean of the last ten scans is 0.7: 1 - 0.9^12. One that leaves is forgotten. */
static void it_comes_and_goes(void)
{
    memset(&company, 0, sizeof company);
    size_t first = 0u;
    for (size_t at = 0; at < 80u; at++) {
        see(0.101 * (double)at, at < 40u ? 0.0 : 1.2);
        const size_t left_out = drop(0.101 * (double)at);
        CHECK(at >= 40u || left_out == 0u);
        first = first == 0u && left_out > 0u ? at : first;
    }
    CHECK(first == 40u + 5u + 11u); /* the view before it is 0.5 m behind */
    for (size_t at = 80u; at < 100u; at++) {
        see(0.101 * (double)at, 0.0);
        CHECK(drop(0.101 * (double)at) == 0u);
    }
    CHECK(company.often < EK_R(0.3));
}

/* Where nothing is nearer than 3 m, or more than 30 % move along, the wheels slip; without hits nothing is known. */
static void wheels_that_slip_leave_nothing_out(void)
{
    for (size_t kind = 0; kind < 3u; kind++) {
        memset(&company, 0, sizeof company);
        for (size_t at = 0; at < 30u; at++) {
            see(0.0, 0.0);
            for (size_t k = 0; k < BEAMS; k++) {
                const double c = fabs(cos((double)angles[k])), s = fabs(sin((double)angles[k]));
                ranges[k] = kind == 0u ? EK_R(3.1) : kind == 1u ? EK_R(1.0 / fmax(c, s)) : (ek_real)INFINITY;
            }
            CHECK(drop(0.1 * (double)at) == 0u);
        }
        CHECK(company.scans == (kind == 2u ? 0u : 10u) && company.often <= EK_R(0.0));
    }
}

/* Beyond 0.1 m in 0.5 m it has another speed; a quarter of the hits at 0.3 m moves along while the robot turns on the spot. */
static void another_speed_stays_and_turns_tell_too(void)
{
    memset(&company, 0, sizeof company);
    for (size_t at = 0; at < 30u; at++) {
        see(0.101 * (double)at, 1.2 + 0.03 * (double)at);
        CHECK(drop(0.101 * (double)at) == 0u);
    }
    memset(&company, 0, sizeof company);
    for (size_t at = 0; at < 30u; at++) {
        const double turn = (double)at * 5.0 * PI / 180.0;
        for (size_t k = 0; k < BEAMS; k++) {
            const double to_wall = 4.0 / fmax(fabs(cos((double)angles[k] + turn)), fabs(sin((double)angles[k] + turn)));
            ranges[k] = EK_R(is_behind(k) ? 0.3 : to_wall);
        }
        const ek_pose odom_from_sensor = {EK_R(0.0), EK_R(0.0), EK_R(turn)};
        const size_t left_out = ek_drop_companions(views, &company, ranges, angles, BEAMS, LOW, HIGH, odom_from_sensor);
        CHECK(left_out == (at < 5u ? 0u : 25u) || at == 4u);
    }
}

/* A refused sweep: the company is not taken, and what it keeps is as it was. Angles that are refused later do no harm. */
static void what_is_not_taken_changes_nothing(void)
{
    memset(&company, 0, sizeof company);
    for (size_t at = 0; at < 15u; at++) {
        see(0.101 * (double)at, 1.2);
        drop(0.101 * (double)at);
    }
    const ek_company before = company;
    const ek_view older = views[before.older - 1u], newer = views[before.newer - 1u];
    for (size_t k = 0; k < BEAMS; k++) {
        ranges[k] = EK_R(1.0);
        angles[k] = k % 3u == 0u ? (ek_real)NAN : k % 3u == 1u ? (ek_real)INFINITY : EK_R(1e30);
    }
    drop(9.0);
    CHECK(memcmp(&older, &views[before.older - 1u], sizeof older) == 0);
    CHECK(memcmp(&newer, &views[before.newer - 1u], sizeof newer) == 0);
    company = before;
    see(1.6, 1.2);
    CHECK(drop(1.6) == 25u);
}

int main(void)
{
    a_companion_is_left_out_and_the_walls_stay();
    it_comes_and_goes();
    another_speed_stays_and_turns_tell_too();
    wheels_that_slip_leave_nothing_out();
    what_is_not_taken_changes_nothing();
    return failures ? EXIT_FAILURE : EXIT_SUCCESS;
}

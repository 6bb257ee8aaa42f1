#include "check.h"
#include "ek/sweep_times.h"
#include "walls.h"

#define BEAMS 360u
#define TURN 0.15 /* rad a scan, of a lidar 0.2 m ahead of the middle of the base */
#define PERIOD_NS 100000000

static ek_real ranges[BEAMS], angles[BEAMS], map_xy[20000];
static const ek_pose mount = {EK_R(0.2), EK_R(0.0), EK_R(0.0)};
static ek_observer observer;
static ek_thinner thinner;
static ek_scan scan;
static ek_index map;

static void start(void)
{
    ek_arena arena = memory_of((size_t)1 << 23);
    CHECK(ek_observer_init(&observer, &arena, BEAMS) == EK_OK && ek_thinner_init(&thinner, &arena, BEAMS) == EK_OK);
    CHECK(ek_scan_init(&scan, &arena, BEAMS) == EK_OK && ek_index_init(&map, &arena, 10000u, 40000u) == EK_OK);
    size_t count = 0u;
    for (unsigned k = 0; k < WALLS; k++) {
        const double dx = walls[k][2] - walls[k][0], dy = walls[k][3] - walls[k][1], length = sqrt(dx * dx + dy * dy);
        for (double at = 0.0; at < length; at += 0.01, count++) {
            map_xy[2u * count] = EK_R(walls[k][0] + at / length * dx);
            map_xy[2u * count + 1u] = EK_R(walls[k][1] + at / length * dy);
        }
    }
    CHECK(ek_index_build(&map, map_xy, count) == EK_OK && ek_arena_check(&arena) == EK_OK);
}

/* A scan of a lidar that turns while the base turns about a place, at its middle at the pose `middle`; a beam is fired
 * at a share of the sweep, in the order of the angles (1) or in the opposite one (-1), or all at once (0). */
static ek_sweep sweep_at(ek_pose middle, int order)
{
    ek_sweep sweep = {.stamp_ns = 0, .ranges = ranges, .angles = angles, .beams = BEAMS};
    for (size_t k = 0; k < BEAMS; k++) {
        const double fired = ((double)k + 0.5) / BEAMS - 0.5;
        ek_pose base = middle;
        base.theta += EK_R(TURN * order * fired);
        angles[k] = EK_PI * (EK_R(2.0) * (ek_real)k / (ek_real)BEAMS - EK_R(1.0));
        ranges[k] = EK_R(range_at(ek_se2_compose(base, mount), (double)angles[k]));
    }
    return sweep;
}

/* Observe scans against the true map while nothing is assumed; until the sums decide. */
static ek_sweep_times observe(int order, double turn)
{
    const ek_scan_parameters parameters = {mount, EK_R(0.1), EK_R(30.0), EK_R(0.0)};
    const ek_sweep_step step = {{EK_R(0.0), EK_R(0.0), EK_R(turn)}, PERIOD_NS, PERIOD_NS};
    ek_sweep_times times = {.order = 0};
    for (unsigned k = 0; k < 40u; k++) {
        const ek_pose at = {EK_R(4.0), EK_R(2.2), EK_R(0.3 + TURN * k)};
        const ek_sweep sweep = sweep_at(at, order);
        ek_work work = ek_work_make(INT64_MAX);
        CHECK(ek_scan_project(&scan, &sweep, &parameters, NULL) == EK_OK);
        ek_observer_take(&observer, &thinner, scan.hits, scan.count, &work);
        CHECK(ek_sweep_times_applies(&sweep));
        ek_sweep_times_observe(&times, &observer, &map, at, EK_R(0.3), &sweep, mount, &step);
        if (times.order != 0) {
            break;
        }
    }
    return times;
}

/* Residuals from a true map tell the whole share, so that twice of it is more than is needed. */
static void the_order_of_the_beams_is_found(void)
{
    CHECK(observe(1, TURN).order == 1);
    CHECK(observe(-1, TURN).order == -1);
}

static void beams_that_are_fired_at_once_are_left_alone(void)
{
    const ek_sweep_times times = observe(0, TURN);
    CHECK(times.order == 0 && EK_FABS(times.share) < EK_R(0.1) && EK_FABS(times.share) > EK_R(0.0));
}

static void a_robot_that_hardly_turns_tells_nothing(void)
{
    const ek_sweep_times times = observe(1, 0.034);
    CHECK(times.order == 0 && !(times.squared > EK_R(0.0)));
}

static void a_part_of_a_circle_and_times_of_beams_are_not_asked(void)
{
    const ek_pose at = {EK_R(4.0), EK_R(2.2), EK_R(0.0)};
    ek_sweep sweep = sweep_at(at, 0);
    CHECK(ek_sweep_times_applies(&sweep));
    sweep.time_increment_ns = 1;
    CHECK(!ek_sweep_times_applies(&sweep));
    sweep.time_increment_ns = 0;
    sweep.beams = 300u; /* 299 deg */
    CHECK(!ek_sweep_times_applies(&sweep));
    sweep.beams = 302u;
    CHECK(ek_sweep_times_applies(&sweep));
    sweep.beams = 1u;
    CHECK(!ek_sweep_times_applies(&sweep));
}

static void a_sweep_takes_a_period_as_soon_as_its_order_is_known(void)
{
    const ek_pose at = {EK_R(4.0), EK_R(2.2), EK_R(0.0)};
    ek_sweep sweep = sweep_at(at, 0);
    ek_sweep_times times = {.order = 0};
    CHECK(ek_sweep_times_take(&times, &sweep, PERIOD_NS) == 0);
    times.order = -1;
    CHECK(ek_sweep_times_take(&times, &sweep, PERIOD_NS) == -PERIOD_NS);
    CHECK(ek_sweep_times_take(&times, &sweep, 0) == 0);
    times.order = 1;
    CHECK(ek_sweep_times_take(&times, &sweep, PERIOD_NS) == PERIOD_NS);
    sweep.time_increment_ns = 1;
    CHECK(ek_sweep_times_take(&times, &sweep, PERIOD_NS) == 0);
}

int main(void)
{
    start();
    the_order_of_the_beams_is_found();
    beams_that_are_fired_at_once_are_left_alone();
    a_robot_that_hardly_turns_tells_nothing();
    a_part_of_a_circle_and_times_of_beams_are_not_asked();
    a_sweep_takes_a_period_as_soon_as_its_order_is_known();
    return verdict();
}

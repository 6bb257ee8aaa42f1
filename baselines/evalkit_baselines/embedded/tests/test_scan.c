#include "check.h"
#include "ek/scan.h"

#define BEAMS 5u

static ek_scan scan;
static ek_scan_parameters parameters;
static ek_real ranges[BEAMS], angles[BEAMS];

static ek_sweep sweep_of(size_t beams)
{
    ek_sweep sweep;
    memset(&sweep, 0, sizeof sweep);
    sweep.ranges = ranges;
    sweep.angles = angles;
    sweep.beams = beams;
    return sweep;
}

static void only_returns_within_the_limits_count(void)
{
    const double given[BEAMS] = {2.0, (double)INFINITY, (double)NAN, 0.05, 13.0};
    for (unsigned k = 0; k < BEAMS; k++) {
        ranges[k] = (ek_real)given[k];
        angles[k] = EK_PI / EK_R(2.0);
    }
    const ek_sweep sweep = sweep_of(BEAMS);
    parameters.base_from_sensor.x = EK_R(0.5);
    CHECK(ek_scan_project(&scan, &sweep, &parameters, NULL) == EK_OK);
    CHECK(scan.count == 1u && scan.misses == 1u);
    CHECK_NEAR(scan.hits[0], 0.5, TOLERANCE);
    CHECK_NEAR(scan.hits[1], 2.0, TOLERANCE);
    CHECK_NEAR(scan.ends[0], 0.5, TOLERANCE);
    CHECK_NEAR(scan.ends[1], 12.0, TOLERANCE);
    ranges[0] = -(ek_real)INFINITY;
    CHECK(ek_scan_project(&scan, &sweep, &parameters, NULL) == EK_OK && scan.count == 0u && scan.misses == 1u);
    parameters.base_from_sensor.x = EK_R(0.0);
}

/* A sensor on an arc measures one fixed point: after deskewing, all beams give the point of the first beam. */
static void motion_is_undone(ek_pose start_from_end)
{
    const double x = 3.0, y = 1.0;
    for (unsigned k = 0; k < BEAMS; k++) {
        const ek_pose moved = ek_se2_inverse(ek_se2_fraction(start_from_end, EK_R(k) / EK_R(4.0)));
        const double c = cos((double)moved.theta), s = sin((double)moved.theta);
        const double u = c * x - s * y + (double)moved.x, v = s * x + c * y + (double)moved.y;
        ranges[k] = EK_R(sqrt(u * u + v * v));
        angles[k] = EK_R(atan2(v, u));
    }
    const ek_sweep sweep = sweep_of(BEAMS);
    CHECK(ek_scan_project(&scan, &sweep, &parameters, &start_from_end) == EK_OK && scan.count == BEAMS);
    for (size_t k = 0; k < scan.count; k++) {
        CHECK_NEAR(scan.hits[2u * k], x, 10.0 * TOLERANCE);
        CHECK_NEAR(scan.hits[2u * k + 1u], y, 10.0 * TOLERANCE);
    }
}

/* Points that a later step would refuse are ignored here, for every radius. */
static void points_beyond_all_bounds_are_left_out(void)
{
    ek_scan_parameters far = parameters;
    ranges[0] = EK_R(1.0);
    ranges[1] = (ek_real)INFINITY;
    angles[0] = angles[1] = EK_R(0.0);
    const ek_sweep sweep = sweep_of(2u);
    far.base_from_sensor.x = EK_R(2e6);
    far.local_radius = EK_R(1e30);
    CHECK(ek_scan_project(&scan, &sweep, &far, NULL) == EK_OK && scan.count == 0u && scan.misses == 1u);
#ifdef EK_FLOAT
    angles[1] = far.base_from_sensor.theta = EK_R(3e38);
#else
    angles[1] = far.base_from_sensor.theta = EK_R(1.5e308);
#endif
    CHECK(ek_scan_project(&scan, &sweep, &far, NULL) == EK_OK && scan.misses == 0u);
}

static void bad_input_is_named(void)
{
    ek_sweep sweep = sweep_of(0u);
    const ek_pose broken = {(ek_real)NAN, EK_R(0.0), EK_R(0.0)};
    CHECK(ek_scan_project(&scan, &sweep, &parameters, NULL) == EK_NO_POINTS);
    sweep.beams = BEAMS + 1u;
    CHECK(ek_scan_project(&scan, &sweep, &parameters, NULL) == EK_TOO_MANY_POINTS);
    sweep.beams = BEAMS;
    CHECK(ek_scan_project(&scan, &sweep, &parameters, &broken) == EK_NOT_FINITE);
    CHECK(ek_scan_project(NULL, &sweep, &parameters, NULL) == EK_NULL_POINTER);
    sweep.ranges = NULL;
    CHECK(ek_scan_project(&scan, &sweep, &parameters, NULL) == EK_NULL_POINTER);
    sweep = sweep_of(BEAMS);
    angles[3] = (ek_real)INFINITY;
    CHECK(ek_scan_project(&scan, &sweep, &parameters, NULL) == EK_NOT_FINITE && scan.count == 0u);
    ek_scan_parameters wrong = parameters;
    wrong.range_min = EK_R(20.0);
    CHECK(ek_scan_check(&wrong) == EK_OUT_OF_RANGE);
}

int main(void)
{
    ek_arena arena = memory_of(4096u);
    memset(&parameters, 0, sizeof parameters);
    parameters.range_min = EK_R(0.15);
    parameters.range_max = EK_R(12.0);
    CHECK(ek_scan_init(&scan, &arena, BEAMS) == EK_OK && ek_arena_check(&arena) == EK_OK);
    only_returns_within_the_limits_count();
    const ek_pose slow = {EK_R(0.02), EK_R(0.001), EK_R(0.05)}, quick = {EK_R(0.3), EK_R(0.1), EK_R(0.6)};
    const ek_pose straight = {EK_R(0.3), EK_R(0.0), EK_R(0.0)};
    motion_is_undone(slow);
    motion_is_undone(quick);
    motion_is_undone(straight);
    points_beyond_all_bounds_are_left_out();
    bad_input_is_named();
    free(arena.memory);
    return verdict();
}

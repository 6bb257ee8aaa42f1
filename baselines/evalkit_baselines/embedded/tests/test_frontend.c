#include "check.h"
#include "ek/frontend.h"
#include "walls.h"

#define BEAMS 720u

static const ek_pose ORIGIN = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};

static ek_frontend frontend;
static ek_real points[2u * BEAMS];

static ek_pose truth_at(int k)
{
    const ek_pose pose = {EK_R(1.2 + 0.03 * k), EK_R(1.2 + 0.01 * k), EK_R(0.012 * k)};
    return pose;
}

static void see(ek_pose world_from_base)
{
    for (unsigned k = 0; k < BEAMS; k++) {
        const double angle = 2.0 * (double)EK_PI * k / BEAMS, range = range_at(world_from_base, angle);
        points[2u * k] = EK_R(range * cos(angle));
        points[2u * k + 1u] = EK_R(range * sin(angle));
    }
}

/* Run the front end over `scans` scans; returns the error (m) of the last pose. */
static double follow(int scans, int with_odometry)
{
    ek_estimate estimate;
    double error = 0.0;
    int keyframes = 0;
    for (int k = 0; k < scans; k++) {
        const ek_pose truth = truth_at(k), start_from_base = ek_se2_between(truth_at(0), truth);
        ek_prior prior = {100000000 * (int64_t)(k + 1), with_odometry, start_from_base};
        prior.odom_from_base.x *= EK_R(1.05); /* wheels slip */
        prior.odom_from_base.theta *= EK_R(0.95);
        see(truth);
        CHECK(ek_frontend_update(&frontend, points, BEAMS, &prior, &estimate) == EK_OK);
        keyframes += estimate.keyframe;
        const double dx = (double)(estimate.start_from_base.x - start_from_base.x);
        const double dy = (double)(estimate.start_from_base.y - start_from_base.y);
        error = sqrt(dx * dx + dy * dy);
        CHECK(k == 0 || (estimate.scan_to_scan.iterations > 0 && estimate.scan_to_map.iterations > 0));
        CHECK(estimate.scan_to_scan_outcome == (k ? EK_STAGE_ACCEPTED : EK_STAGE_SKIPPED));
        CHECK(estimate.scan_to_map_outcome == (k ? EK_STAGE_ACCEPTED : EK_STAGE_SKIPPED));
    }
    CHECK(keyframes >= 4);
    return error;
}

static void the_robot_is_followed(void)
{
    CHECK(follow(80, 1) < 0.02);
    ek_frontend_reset(&frontend);
    CHECK(follow(80, 0) < 0.02);
}

static void a_scan_without_points_gets_the_guess(void)
{
    ek_estimate before, after;
    ek_prior prior;
    memset(&prior, 0, sizeof prior);
    ek_frontend_reset(&frontend);
    for (int k = 0; k < 5; k++) {
        prior.stamp_ns = k + 1;
        see(truth_at(k));
        CHECK(ek_frontend_update(&frontend, points, BEAMS, &prior, &before) == EK_OK);
    }
    prior.stamp_ns = 6;
    CHECK(ek_frontend_update(&frontend, points, 0u, &prior, &after) == EK_OK);
    CHECK(after.scan_to_map.iterations == 0 && !after.keyframe);
    CHECK(after.scan_to_scan_outcome == EK_STAGE_GUESS_KEPT && after.scan_to_map_outcome == EK_STAGE_GUESS_KEPT);
    CHECK_NEAR(after.start_from_base.x - before.start_from_base.x, 0.032, 0.02);
    prior.stamp_ns = 7;
    see(truth_at(6));
    CHECK(ek_frontend_update(&frontend, points, BEAMS, &prior, &after) == EK_OK);
    CHECK_NEAR(after.start_from_base.x, 6.0 * 0.03, 0.02);
}

static void times_as_far_apart_as_can_be_are_no_motion(void)
{
    ek_estimate estimate;
    ek_prior prior;
    memset(&prior, 0, sizeof prior);
    const int64_t stamps[] = {INT64_MIN, INT64_MAX - 1, INT64_MAX};
    ek_frontend_reset(&frontend);
    for (int k = 0; k < 3; k++) {
        prior.stamp_ns = stamps[k];
        see(truth_at(k));
        CHECK(ek_frontend_update(&frontend, points, BEAMS, &prior, &estimate) == EK_OK);
        CHECK(ek_se2_is_finite(estimate.start_from_base));
    }
    CHECK_NEAR(estimate.start_from_base.x, 0.06, 0.02);
}

/* A scan that leads beyond the bounds is refused; the next one gives the same result as without it. */
static void a_scan_that_is_refused_leaves_no_trace(void)
{
    static const double away[] = {2e6, 0.9999999e6, 1e30};
    ek_estimate estimate;
    for (int which = 0; which < 3; which++) {
        ek_prior prior = {1, 1, {EK_R(0.0), EK_R(0.0), EK_R(0.0)}};
        ek_frontend_reset(&frontend);
        see(truth_at(0));
        CHECK(ek_frontend_update(&frontend, points, BEAMS, &prior, &estimate) == EK_OK);
        prior.stamp_ns = 2;
        prior.odom_from_base.x = EK_R(away[which]);
        prior.odom_from_base.theta = EK_R(1e30);
        const ek_index local_map = frontend.local_map, last = frontend.last;
        const uint32_t held = frontend.keyframe_count;
        frontend.parameters.use_scan_to_scan = frontend.parameters.use_scan_to_map = 0;
        CHECK(ek_frontend_update(&frontend, points, BEAMS, &prior, &estimate) == EK_OUT_OF_RANGE);
        frontend.parameters.use_scan_to_scan = frontend.parameters.use_scan_to_map = 1;
        CHECK(frontend.local_map.count == local_map.count && frontend.last.count == last.count &&
              frontend.keyframe_count == held);
        see(truth_at(1));
        prior.odom_from_base = ek_se2_between(truth_at(0), truth_at(1));
        CHECK(ek_frontend_update(&frontend, points, BEAMS, &prior, &estimate) == EK_OK);
        CHECK_NEAR(estimate.start_from_base.x, 0.03, 0.02);
        CHECK(estimate.scan_to_map_outcome == EK_STAGE_ACCEPTED);
    }
}

static void init_with(ek_arena *arena, const ek_frontend_parameters *parameters)
{
    arena->used = 0u;
    CHECK(ek_frontend_init(&frontend, arena, parameters) == EK_OK && ek_arena_check(arena) == EK_OK);
    ek_frontend_reset(&frontend);
}

/* With two keyframes the third takes the place of the first: the local map holds the points of the last two. */
static void the_oldest_keyframe_leaves_a_full_map(ek_arena *arena, ek_frontend_parameters parameters)
{
    ek_estimate estimate;
    parameters.keyframes = 2u;
    parameters.keyframe_distance = EK_R(1e3); /* by its turn alone */
    parameters.keyframe_angle = EK_R(0.1);
    init_with(arena, &parameters);
    unsigned keyframes = 0u;
    for (int k = 0; k < 40; k++) {
        const ek_prior prior = {k + 1, 1, ek_se2_between(truth_at(0), truth_at(k))};
        see(truth_at(k));
        CHECK(ek_frontend_update(&frontend, points, BEAMS, &prior, &estimate) == EK_OK);
        keyframes += (unsigned)estimate.keyframe;
        CHECK(frontend.keyframe_count == (keyframes < 2u ? keyframes : 2u));
        CHECK(frontend.local_map.count == BEAMS * frontend.keyframe_count);
    }
    CHECK(keyframes >= 4u && keyframes <= 5u); /* 0.468 rad in steps of 0.1 */
    CHECK_NEAR(estimate.start_from_base.x, ek_se2_between(truth_at(0), truth_at(39)).x, 0.02);
}

/* More pairs than there are points are asked for: every result is rejected, and the guess by the wheels is kept. */
static void too_few_pairs_keep_the_guess(ek_arena *arena, ek_frontend_parameters parameters)
{
    ek_estimate estimate;
    parameters.min_inliers = (int32_t)BEAMS + 1;
    init_with(arena, &parameters);
    for (int k = 0; k < 3; k++) {
        const ek_prior prior = {k + 1, 1, {EK_R(0.01 * k), EK_R(-0.02 * k), EK_R(0.0)}};
        see(truth_at(k));
        CHECK(ek_frontend_update(&frontend, points, BEAMS, &prior, &estimate) == EK_OK);
        CHECK_NEAR(estimate.start_from_base.x, 0.01 * k, TOLERANCE);
        CHECK_NEAR(estimate.start_from_base.y, -0.02 * k, TOLERANCE);
        CHECK(k == 0 || (estimate.scan_to_scan_outcome == EK_STAGE_GUESS_KEPT && estimate.scan_to_map_outcome == EK_STAGE_GUESS_KEPT));
    }
}

/* Three keyframes of different sizes at most: the map holds the points of the last three, at their own places. */
static void keyframes_leave_in_the_order_they_came(ek_arena *arena, ek_frontend_parameters parameters)
{
    static const size_t counts[] = {3u, 5u, 8u, 2u, 7u, 4u, 1u, 6u};
    ek_estimate estimate;
    parameters.keyframes = 3u;
    parameters.use_scan_to_scan = parameters.use_scan_to_map = 0;
    init_with(arena, &parameters);
    for (size_t k = 0; k < sizeof counts / sizeof *counts; k++) {
        const ek_prior prior = {(int64_t)k + 1, 1, {EK_R(k), EK_R(0.0), ek_se2_wrap(EK_R(0.5) * EK_PI * (ek_real)(k % 4u))}};
        for (size_t i = 0; i < counts[k]; i++) {
            points[2u * i] = EK_R(0.25);
            points[2u * i + 1u] = EK_R(0.0);
        }
        CHECK(ek_frontend_update(&frontend, points, counts[k], &prior, &estimate) == EK_OK && estimate.keyframe);
        const size_t first = k < 3u ? 0u : k - 2u;
        size_t all = 0u;
        for (size_t i = first; i <= k; i++) {
            all += counts[i];
        }
        CHECK(frontend.local_map.count == all && frontend.keyframe_count == (k < 3u ? k + 1u : 3u));
        for (size_t slot = 0; slot < all; slot++) { /* a quarter of a metre ahead, to the left, behind or to the right */
            const double x = (double)frontend.local_map.xy[2u * slot], y = (double)frontend.local_map.xy[2u * slot + 1u];
            const double near = floor(x + 0.5), turn = fmod(near, 4.0);
            CHECK(near >= (double)first && near <= (double)k);
            CHECK_NEAR(x - near, turn == 0.0 ? 0.25 : turn == 2.0 ? -0.25 : 0.0, 1e-5);
            CHECK_NEAR(y, turn == 1.0 ? 0.25 : turn == 3.0 ? -0.25 : 0.0, 1e-5);
        }
    }
}

/* A keyframe's points stay within the world, whatever its heading; those of another scan need not. */
static void the_points_of_a_keyframe_stay_in_the_world(ek_arena *arena, ek_frontend_parameters parameters)
{
    static const struct {
        double x, y, u, v;
        ek_status status;
    } cases[] = {{999980.0, 0.0, 10.0, 0.0, EK_OK},           {999980.0, 0.0, 0.0, 10.0, EK_OK},
                 {999980.0, 0.0, 30.0, 0.0, EK_OUT_OF_RANGE}, {999980.0, 0.0, 0.0, 30.0, EK_OUT_OF_RANGE},
                 {0.0, -999980.0, 0.0, 30.0, EK_OUT_OF_RANGE}, {0.0, -999980.0, 16.0, 16.0, EK_OUT_OF_RANGE},
                 {0.0, -999980.0, 12.0, -12.0, EK_OK},        {-1000001.0, 0.0, 0.0, 0.0, EK_OUT_OF_RANGE}};
    parameters.use_scan_to_scan = parameters.use_scan_to_map = 0;
    for (int keyframe = 0; keyframe < 2; keyframe++) {
        parameters.keyframe_distance = EK_R(keyframe ? 0.5 : 1e7);
        for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
            ek_estimate estimate;
            ek_prior prior = {1, 1, {EK_R(0.0), EK_R(0.0), EK_R(0.0)}};
            init_with(arena, &parameters);
            points[0] = points[1] = EK_R(1.0);
            CHECK(ek_frontend_update(&frontend, points, 1u, &prior, &estimate) == EK_OK);
            prior.stamp_ns = 2;
            prior.odom_from_base.x = EK_R(cases[k].x);
            prior.odom_from_base.y = EK_R(cases[k].y);
            points[2] = EK_R(cases[k].u); /* the second point */
            points[3] = EK_R(cases[k].v);
            const int outside = fabs(cases[k].x) > 1e6;
            CHECK(ek_frontend_update(&frontend, points, 2u, &prior, &estimate) == (keyframe || outside ? cases[k].status : EK_OK));
        }
    }
}

/* Odometry that leads out of the world or overflows is refused, with and without a match; so is a map at its very end. */
static void odometry_out_of_the_world_is_refused(ek_arena *arena, const ek_frontend_parameters *parameters)
{
    const double most = sizeof(ek_real) == sizeof(float) ? 3e38 : 1.7e308;
    const struct {
        double x, y, theta;
        ek_status status;
    } cases[] = {{1.1e6, 0.0, 0.0, EK_OUT_OF_RANGE}, {0.0, 1.1e6, 0.0, EK_OUT_OF_RANGE}, {1e6, 0.0, 0.0, EK_OUT_OF_RANGE},
                 {0.0, -1e6, 0.0, EK_OUT_OF_RANGE},  {most, most, 0.8, EK_NOT_FINITE}};
    ek_estimate estimate;
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        for (int stages = 0; stages < 2; stages++) {
            ek_prior prior = {1, 1, {EK_R(0.0), EK_R(0.0), EK_R(0.8)}};
            init_with(arena, parameters);
            frontend.parameters.use_scan_to_scan = frontend.parameters.use_scan_to_map = stages;
            see(truth_at(0));
            CHECK(ek_frontend_update(&frontend, points, BEAMS, &prior, &estimate) == EK_OK);
            prior.stamp_ns = 2;
            const ek_pose step = {EK_R(cases[k].x), EK_R(cases[k].y), EK_R(0.0)};
            prior.odom_from_base = cases[k].status == EK_NOT_FINITE ? step : ek_se2_compose(prior.odom_from_base, step);
            const ek_status status = ek_frontend_update(&frontend, points, BEAMS, &prior, &estimate);
            CHECK(status == cases[k].status);
            CHECK(frontend.keyframe_count == 1u && frontend.motion.stamp_ns == 1);
        }
    }
}

static ek_frontend_parameters lasting_lines(ek_frontend_parameters parameters)
{
    parameters.map_voxel = EK_R(0.1);
    parameters.map_radius = EK_R(3.0);
    parameters.voxels = 1000u;
    parameters.scan_to_scan.metric = parameters.scan_to_map.metric = EK_METRIC_LINE;
    parameters.scan_to_scan.one_to_one = parameters.scan_to_map.one_to_one = 0;
    return parameters;
}

/* The map of all keyframes has no voxel twice, and the part to match with lies around the robot. */
static void a_lasting_map_of_lines_is_matched_around_the_robot(ek_arena *arena, ek_frontend_parameters parameters)
{
    init_with(arena, &parameters);
    CHECK(follow(80, 1) < 0.02);
    const ek_lasting_map *const map = &frontend.lasting;
    CHECK(map->voxels.dropped == 0u && map->around.count < map->voxels.count && map->around.count > 50u);
    CHECK(map->voxels.count < 500u); /* 28 m of walls and 6 m of boxes: some 340 voxels, and those beside them */
    for (size_t k = 0; k < map->around.count; k++) {
        const double dx = (double)(map->around.xy[2u * k] - map->centre_x), dy = (double)(map->around.xy[2u * k + 1u] - map->centre_y);
        CHECK(sqrt(dx * dx + dy * dy) <= 3.0 + TOLERANCE);
    }
    ek_frontend_reset(&frontend);
    CHECK(map->voxels.count == 0u && map->around.count == 0u);
    CHECK(follow(80, 0) < 0.02);
    parameters.map_voxel = EK_R(0.0); /* the same lines of the last keyframes */
    init_with(arena, &parameters);
    CHECK(follow(80, 1) < 0.01);
}

/* A scan whose keyframe would lie out of the world moves the centre of the map there and back: the scan after it gives the
 * same pose as without it. */
static void a_refused_scan_leaves_the_part_of_the_lasting_map(ek_arena *arena, ek_frontend_parameters parameters)
{
    ek_pose poses[2];
    for (int refused = 0; refused < 2; refused++) {
        ek_estimate estimate;
        init_with(arena, &parameters);
        for (int k = 0; k < 6; k++) {
            ek_prior prior = {2 * k + 1, 1, ek_se2_between(truth_at(0), truth_at(k))};
            see(truth_at(k));
            CHECK(ek_frontend_update(&frontend, points, BEAMS, &prior, &estimate) == EK_OK);
            const ek_real centre = frontend.lasting.centre_x;
            const size_t around = frontend.lasting.around.count;
            const int32_t changed = frontend.lasting.changed;
            prior.stamp_ns++;
            prior.odom_from_base.x = EK_R(0.9999999e6);
            CHECK(!refused || ek_frontend_update(&frontend, points, BEAMS, &prior, &estimate) == EK_OUT_OF_RANGE);
            CHECK(frontend.lasting.centre_x == centre && frontend.lasting.changed == changed);
            CHECK(changed || frontend.lasting.around.count == around);
        }
        poses[refused] = frontend.motion.start_from_base;
    }
    CHECK(poses[0].x == poses[1].x && poses[0].y == poses[1].y && poses[0].theta == poses[1].theta);
}

/* A map of which another part was taken goes back to the one before: along x, along y, and not where it was to be taken
 * again in any case. A part is taken again from a tenth of the radius on. */
static void a_lasting_map_returns_to_its_part(void)
{
    static const double moves[][2] = {{0.31, 0.0}, {0.0, -0.31}, {0.22, 0.22}, {0.2, -0.2}, {0.0, 0.0}};
    ek_lasting_map map;
    ek_arena measured = ek_arena_make(NULL, 0u);
    CHECK(ek_lasting_map_init(&map, &measured, 100u, EK_R(0.1), EK_R(3.0), 8u, 0u) == EK_OK);
    ek_arena arena = memory_of(measured.used);
    CHECK(ek_lasting_map_init(&map, &arena, 100u, EK_R(0.1), EK_R(3.0), 8u, 0u) == EK_OK && ek_arena_check(&arena) == EK_OK);
    const ek_real four[] = {EK_R(3.05), EK_R(0.0), EK_R(0.0), EK_R(-3.05), EK_R(1.0), EK_R(1.0), EK_R(-1.0), EK_R(-1.0)};
    for (size_t k = 0; k < 5u; k++) {
        for (int changed = 0; changed < 2; changed++) {
            ek_lasting_map_clear(&map);
            ek_lasting_map_add(&map, four, 4u, ORIGIN);
            CHECK(ek_lasting_map_near(&map, EK_R(0.0), EK_R(0.0)) == EK_OK && map.around.count == 2u && !map.changed);
            const uint32_t version = map.around.version;
            CHECK(ek_lasting_map_near(&map, EK_R(moves[k][0]), EK_R(moves[k][1])) == EK_OK);
            const int taken = k < 3u;
            CHECK(map.around.count == (taken ? 3u : 2u) && map.around.version == version + (uint32_t)taken);
            CHECK_NEAR(map.centre_x, taken ? moves[k][0] : 0.0, 1e-7);
            CHECK(ek_lasting_map_return(&map, EK_R(0.0), EK_R(0.0), changed) == EK_OK && map.changed == changed);
            CHECK(map.around.version == version + (taken ? changed ? 1u : 2u : 0u));
            CHECK(map.around.count == (changed && taken ? 3u : 2u));
            CHECK_NEAR(map.centre_x, 0.0, 0.0);
            CHECK_NEAR(map.centre_y, 0.0, 0.0);
        }
    }
    free(arena.memory);
}

/* A keyframe takes the voxels that are left; the others are counted. */
static void a_full_lasting_map_counts_what_it_leaves_out(ek_arena *arena, ek_frontend_parameters parameters)
{
    parameters.voxels = 100u;
    init_with(arena, &parameters);
    ek_prior prior = {1, 1, {EK_R(0.0), EK_R(0.0), EK_R(0.0)}};
    ek_estimate estimate;
    see(truth_at(0));
    CHECK(ek_frontend_update(&frontend, points, BEAMS, &prior, &estimate) == EK_OK && estimate.keyframe);
    CHECK(frontend.lasting.voxels.count == 100u && frontend.lasting.voxels.dropped > 100u);
    parameters.map_radius = EK_R(0.0);
    CHECK(ek_frontend_init(&frontend, arena, &parameters) == EK_OUT_OF_RANGE);
    parameters.map_radius = EK_R(3.0);
    parameters.map_voxel = EK_R(1e-3);
    CHECK(ek_frontend_init(&frontend, arena, &parameters) == EK_OUT_OF_RANGE);
    parameters.map_voxel = EK_R(0.1);
    parameters.voxels = 0u;
    CHECK(ek_frontend_init(&frontend, arena, &parameters) == EK_OUT_OF_RANGE);
}

static void bad_input_is_named(void)
{
    ek_estimate estimate;
    ek_prior prior;
    memset(&prior, 0, sizeof prior);
    prior.stamp_ns = 2;
    CHECK(ek_frontend_update(&frontend, points, BEAMS, &prior, &estimate) ==
          EK_OUT_OF_RANGE); /* stamp not later than the last */
    prior.stamp_ns = 8;
    CHECK(ek_frontend_update(&frontend, points, BEAMS + 1u, &prior, &estimate) == EK_TOO_MANY_POINTS);
    points[9] = (ek_real)NAN;
    CHECK(ek_frontend_update(&frontend, points, BEAMS, &prior, &estimate) == EK_NOT_FINITE);
    ek_frontend_parameters bad = ek_frontend_default();
    bad.keyframes = 0u;
    CHECK(ek_frontend_check(&bad) == EK_OUT_OF_RANGE);
}

int main(void)
{
    ek_frontend_parameters parameters = ek_frontend_default();
    ek_arena measured = ek_arena_make(NULL, 0u);
    parameters.points = BEAMS;
    parameters.scan_to_scan.epsilon = parameters.scan_to_map.epsilon = EK_R(1e-6);
    CHECK(ek_frontend_init(&frontend, &measured, &parameters) == EK_OK);
    ek_arena arena = memory_of(measured.used);
    CHECK(ek_frontend_init(&frontend, &arena, &parameters) == EK_OK && ek_arena_check(&arena) == EK_OK);
    ek_frontend_reset(&frontend);
    the_robot_is_followed();
    a_scan_without_points_gets_the_guess();
    times_as_far_apart_as_can_be_are_no_motion();
    a_scan_that_is_refused_leaves_no_trace();
    bad_input_is_named();
    the_oldest_keyframe_leaves_a_full_map(&arena, parameters);
    too_few_pairs_keep_the_guess(&arena, parameters);
    odometry_out_of_the_world_is_refused(&arena, &parameters);
    keyframes_leave_in_the_order_they_came(&arena, parameters);
    the_points_of_a_keyframe_stay_in_the_world(&arena, parameters);
    free(arena.memory);
    a_lasting_map_returns_to_its_part();
    parameters = lasting_lines(parameters);
    ek_frontend_parameters larger = parameters; /* the keyframes of the same lines */
    larger.map_voxel = EK_R(0.0);
    measured = ek_arena_make(NULL, 0u);
    CHECK(ek_frontend_init(&frontend, &measured, &larger) == EK_OK);
    arena = memory_of(measured.used);
    a_lasting_map_of_lines_is_matched_around_the_robot(&arena, parameters);
    a_refused_scan_leaves_the_part_of_the_lasting_map(&arena, parameters);
    a_full_lasting_map_counts_what_it_leaves_out(&arena, parameters);
    free(arena.memory);
    return verdict();
}

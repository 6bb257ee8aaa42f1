/* Which sweeps are refused, which part of the map is taken, which matches are accepted and which scans become keyframes:
 * each on both sides of its bound. */
#include "src/slam.c"
#include "src/slam_track.c"

#include "line.h"

#define CORNER 20u /* points of each wall */

static ek_sweep empty_sweep(int64_t stamp_ns)
{
    ek_sweep sweep;
    memset(&sweep, 0, sizeof sweep);
    sweep.stamp_ns = stamp_ns;
    return sweep;
}

static void sweeps_are_refused_beyond_their_bounds(void)
{
    static const struct {
        double mount_x, mount_y, x, y;
        int has_odometry, ok;
    } cases[] = {{1e3, -1e3, 1e6, -1e6, 1, 1}, {-1000.1, 0, 0, 0, 1, 0}, {0, 1000.1, 0, 0, 0, 0}, {0, 0, 1.0001e6, 0, 1, 0},
                 {0, 0, 0, -1.0001e6, 1, 0},   {0, 0, 9e9, 9e9, 0, 1}};
    ek_arena arena = line_of(1u);
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        ek_sweep sweep = empty_sweep(5);
        slam.parameters.scan.base_from_sensor = pose_of(cases[k].mount_x, cases[k].mount_y, 0.0);
        sweep.has_odometry = cases[k].has_odometry;
        sweep.odom_from_base = pose_of(cases[k].x, cases[k].y, 0.0);
        CHECK(check_sweep(&slam, &sweep) == (cases[k].ok ? EK_OK : EK_OUT_OF_RANGE));
    }
    slam.parameters.scan.base_from_sensor = ORIGIN;
    for (int started = 0; started < 2; started++) {
        for (int64_t stamp = 6; stamp < 9; stamp++) {
            const ek_sweep sweep = empty_sweep(stamp);
            slam.motion.started = started;
            slam.motion.stamp_ns = 7;
            CHECK(check_sweep(&slam, &sweep) == (started && stamp < 8 ? EK_OUT_OF_RANGE : EK_OK));
        }
    }
    for (size_t k = 0; k < 6u; k++) { /* points and poses up to 250 km away, on every side */
        const ek_real far = EK_R(k < 2u ? 2.5e5 : k < 4u ? -2.5e5 : 2.501e5);
        for (size_t i = 0; i < 4u; i++) {
            slam.scan.hits[i] = EK_R(0.0);
        }
        slam.scan.hits[2u + k % 2u] = far;
        slam.scan.count = 2u;
        CHECK(check_points(&slam.scan) == (k < 4u ? EK_OK : EK_OUT_OF_RANGE));
        slam.scan.count = 1u;
        CHECK(check_points(&slam.scan) == EK_OK);
        const ek_pose pose = pose_of(k % 2u ? 0.0 : (double)far, k % 2u ? (double)far : 0.0, 0.0);
        CHECK(is_near(pose) == (k < 4u));
    }
    CHECK(!is_near(pose_of(0.0, 0.0, (double)NAN)));
    free(arena.memory);
}

/* The part of the map within 15 m is taken again more than 1.5 m away, or when the map has changed. */
static void the_map_is_taken_again_after_a_tenth_of_its_radius(void)
{
    static const double cases[][3] = {{1.5, 0.0, 0}, {0.0, -1.5, 0}, {1.51, 0.0, 1}, {0.0, 1.51, 1}, {1.07, 1.07, 1}, {1.05, -1.05, 0}};
    static const ek_real two[] = {EK_R(16.0), EK_R(0.0), EK_R(-3.0), EK_R(0.0)};
    ek_arena arena = line_of(1u);
    slam.parameters.map_radius = EK_R(15.0);
    ek_slam_draw(&slam, 0u, two, 2u, AT_BASE, ORIGIN, &work);
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        for (int changed = 0; changed < 2; changed++) {
            slam.map_changed = 1;
            CHECK(ek_slam_take_map(&slam, pose_of(0.0, 0.0, 1.0), &work) == EK_OK && !slam.map_changed && slam.map_index.count == 1u);
            CHECK_NEAR(slam.map_points[0], -3.0, 1e-5); /* in the continuous frame, although the voxels are turned */
            CHECK_NEAR(slam.map_points[1], 0.0, 1e-5);
            const uint32_t version = slam.map_index.version;
            slam.map_changed = changed;
            const int taken = changed || (int)cases[k][2];
            CHECK(ek_slam_take_map(&slam, pose_of(cases[k][0], cases[k][1], 0.0), &work) == EK_OK && !slam.map_changed);
            CHECK(slam.map_index.version == version + (uint32_t)taken);
            CHECK_NEAR(slam.centre_x, taken ? cases[k][0] : 0.0, 1e-6);
            CHECK_NEAR(slam.centre_y, taken ? cases[k][1] : 0.0, 1e-6);
            CHECK(slam.map_index.count == (taken && cases[k][0] > 1.0 ? 2u : 1u) && slam.map_index.deferred);
        }
    }
    free(arena.memory);
}

/* Two walls of 20 points each, and the scan of them from a pose. */
static void see_corner(ek_pose from)
{
    ek_real target[4u * CORNER];
    for (size_t k = 0; k < 2u * CORNER; k++) {
        const ek_pose at = pose_of(k < CORNER ? 0.2 * (double)k : 4.0, k < CORNER ? -2.0 : 0.2 * (double)(k - CORNER) - 2.0, 0.0);
        const ek_pose seen = ek_se2_between(from, at);
        target[2u * k] = at.x;
        target[2u * k + 1u] = at.y;
        slam.scan.hits[2u * k] = seen.x;
        slam.scan.hits[2u * k + 1u] = seen.y;
    }
    slam.scan.count = 2u * CORNER;
    CHECK(index_lines(&slam.map_index, slam.map_normals, target, 2u * CORNER) == EK_OK);
}

/* Near a keyframe in a room, with as many points, nothing is open; what a match with one wall leaves open there is left
 * to the guess. */
static void what_is_open_is_not_measured_near_a_keyframe_in_a_room(void)
{
    static const double cases[][4] = {{0.2999, 0.0, 100, 1}, {0.3001, 0.0, 100, 0}, {0.0, 0.17, 100, 1}, {0.0, -0.18, 100, 0},
                                      {0.0, 0.0, 98, 1},     {0.0, 0.0, 97, 0},     {0.0, 0.0, 102, 1},  {0.0, 0.0, 103, 0}};
    ek_arena arena = line_of(1u);
    slam.has_keyframe = 1;
    slam.front_count = 100u;
    slam.odom_from_front = pose_of(3.0, 2.0, 0.5);
    for (int closed = 0; closed < 2; closed++) {
        slam.in_room = closed;
        for (size_t k = 0; k < 8u; k++) {
            const ek_pose predicted = ek_se2_compose(slam.odom_from_front, pose_of(cases[k][0], 0.0, cases[k][1]));
            slam.scan.count = (size_t)cases[k][2];
            CHECK(is_closed(&slam, predicted) == (closed && cases[k][3] > 0.0));
        }
    }
    see_corner(ORIGIN);
    slam.scan.count = CORNER; /* the wall along x, */
    for (int closed = 0; closed < 2; closed++) {
        slam.closed = closed;
        slam.observed = 0;
        const ek_pose limited = ek_slam_limit(&slam, &slam.map_index, pose_of(0.1, 0.2, 0.0), pose_of(0.5, 0.0, 0.0));
        CHECK_NEAR(limited.x, closed ? 0.1 : 0.5, 1e-4);
        CHECK_NEAR(limited.y, 0.2, 1e-4);
        CHECK(slam.observed == !closed);
    }
    free(arena.memory);
}

/* A match is the pose with as many pairs as are asked for, and if it does not contradict the odometry. */
static void a_stage_is_accepted_with_enough_pairs(void)
{
    ek_arena arena = line_of(1u);
    ek_match match;
    slam.closed = 1;
    for (int32_t least = 39; least < 42; least++) {
        ek_pose pose = pose_of(0.05, 0.02, 0.01);
        int32_t accepted = 7;
        see_corner(ORIGIN);
        slam.gate.measured = 0;
        slam.parameters.min_inliers = least;
        CHECK(run_stage(&slam, &slam.map_index, NULL, &pose, &match, &accepted) == EK_OK && match.inliers == 40);
        CHECK(accepted == (least <= 40));
        CHECK_NEAR(pose.x, accepted ? 0.0 : 0.05, 1e-4);
    }
    slam.parameters.min_inliers = 10;
    for (int gated = 0; gated < 2; gated++) { /* 0.6 m from the guess, after one iteration: not yet converged */
        ek_pose pose = pose_of(0.6, 0.0, 0.0);
        int32_t accepted = 7;
        see_corner(ORIGIN);
        slam.gate = ek_slam_gate(&slam, gated, ORIGIN);
        slam.tried = 1;
        slam.parameters.matcher.max_iterations = 3;
        CHECK(run_stage(&slam, &slam.map_index, NULL, &pose, &match, &accepted) == EK_OK);
        CHECK(accepted == !gated && (match.inliers == 0) == gated);
        CHECK_NEAR(pose.x, gated ? 0.6 : 0.0, 0.05);
    }
    slam.scan.count = 0u;
    ek_pose pose = pose_of(3.0, 2.0, 1.0);
    int32_t accepted = 7;
    CHECK(run_stage(&slam, &slam.map_index, NULL, &pose, &match, &accepted) == EK_OK && accepted == 0);
    CHECK_NEAR(match.target_from_source.y, 2.0, 0.0);
    free(arena.memory);
}

/* A scan becomes a keyframe 0.3 m or 10 degrees away from the last one that did. */
static void a_keyframe_is_far_enough_from_the_last(void)
{
    const double turn = 10.0 * (double)EK_PI / 180.0;
    const double cases[][4] = {{0.3001, 0.0, 0.0, 1},       {0.0, -0.3001, 0.0, 1}, {0.2999, 0.0, 0.0, 0}, {0.0, 0.2999, 0.0, 0},
                               {0.22, 0.22, 0.0, 1},        {0.2, 0.2, 0.0, 0},     {0.0, 0.0, 1.001 * turn, 1},
                               {0.0, 0.0, -1.001 * turn, 1}, {0.0, 0.0, -0.999 * turn, 0}};
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        ek_arena arena = line_of(0u);
        ek_slam_estimate estimate;
        ek_prior prior = {1, 0, {EK_R(0.0), EK_R(0.0), EK_R(0.0)}};
        memset(&estimate, 0, sizeof estimate);
        slam.scan.count = 1u;
        slam.scan.hits[0] = slam.scan.hits[1] = EK_R(1.0);
        CHECK(keep(&slam, &prior, ORIGIN, &estimate, &work) == EK_OK && slam.keyframes.count == 1u && slam.has_keyframe);
        prior.stamp_ns = 2;
        estimate.odom_from_base = pose_of(cases[k][0], cases[k][1], cases[k][2]);
        CHECK(keep(&slam, &prior, ORIGIN, &estimate, &work) == EK_OK && slam.keyframes.count == (cases[k][3] > 0.0 ? 2u : 1u));
        CHECK(!estimate.lost && slam.last_count == 1u && slam.motion.stamp_ns == 2);
        CHECK_NEAR(slam.odom_from_front.x, cases[k][3] > 0.0 ? cases[k][0] : 0.0, 1e-7);
        free(arena.memory);
    }
}

/* A scan between two keyframes enters the map where it is matched and fits about as usual; what scans are matched with stays. */
static void a_scan_between_keyframes_is_drawn_where_it_fits(void)
{
    static const struct {
        int accepted, inliers, drawn;
        double error;
    } cases[] = {{1, 1, 1, 0.02}, {1, 1, 1, 0.0399}, {1, 1, 0, 0.0401}, {1, 0, 0, 0.02}, {0, 1, 0, 0.02}};
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        ek_arena arena = line_of(0u);
        ek_slam_estimate estimate;
        ek_prior prior = {1, 0, {EK_R(0.0), EK_R(0.0), EK_R(0.0)}};
        memset(&estimate, 0, sizeof estimate);
        slam.scan.count = 1u;
        slam.scan.hits[0] = slam.scan.hits[1] = EK_R(1.02);
        CHECK(keep(&slam, &prior, ORIGIN, &estimate, &work) == EK_OK && slam.maps[slam.drawn].count == 1u);
        prior.stamp_ns = 2;
        slam.map_changed = 0;
        slam.usual_error = EK_R(0.02);
        estimate.odom_from_base = pose_of(0.2, 0.0, 0.0);
        estimate.scan_to_map_accepted = cases[k].accepted;
        estimate.scan_to_map.error = EK_R(cases[k].error);
        estimate.scan_to_map.inliers = cases[k].inliers;
        CHECK(keep(&slam, &prior, ORIGIN, &estimate, &work) == EK_OK && slam.keyframes.count == 1u && !slam.map_changed);
        const ek_voxel_map *const map = slam.maps + slam.drawn;
        CHECK(map->count == (cases[k].drawn ? 2u : 1u));
        CHECK_NEAR(drawn_at(map->voxel + map->count - 1u).x, cases[k].drawn ? 1.22 : 1.02, 1e-6);
        CHECK_NEAR(drawn_at(map->voxel + map->count - 1u).y, 1.02, 1e-6);
        free(arena.memory);
    }
}

/* A poor match is doubted where wheel odometry says otherwise: that of this scan and that of the one before. */
static void only_two_odometries_in_a_row_raise_doubt(void)
{
    static const int had[] = {0, 1, 0, 1}, has[] = {0, 0, 1, 1};
    for (size_t k = 0; k < 4u; k++) {
        ek_arena arena = line_of(1u);
        ek_slam_estimate estimate;
        memset(&estimate, 0, sizeof estimate);
        see_corner(ORIGIN);
        slam.map_changed = 1;
        ek_slam_draw(&slam, 0u, slam.scan.hits, slam.scan.count, AT_BASE, ORIGIN, &work);
        ek_slam_keep_last(&slam, ORIGIN);
        const ek_prior before = {1, had[k], ORIGIN}, prior = {2, has[k], pose_of(0.1, 0.0, 0.0)};
        ek_motion_store(&slam.motion, &before, ORIGIN);
        slam.usual_error = EK_R(1e-9);
        for (size_t i = 0; i < 2u * slam.scan.count; i++) {
            slam.scan.hits[i] += EK_R(i % 4u < 2u ? 0.004 : -0.004);
        }
        CHECK(ek_slam_track(&slam, &prior, &estimate, &work) == EK_OK && estimate.scan_to_map_accepted && estimate.has_scan_to_map);
        CHECK_NEAR(estimate.odom_from_base.x, 0.0, 0.02);
        slam.has_keyframe = 1; /* at the same place: no other one */
        CHECK(keep(&slam, &prior, pose_of(0.1, 0.0, 0.0), &estimate, &work) == EK_OK);
        CHECK_NEAR(slam.doubt.position, k == 3u ? 0.01 : 0.0, k == 3u ? 0.004 : 0.0);
        free(arena.memory);
    }
}

int main(void)
{
    sweeps_are_refused_beyond_their_bounds();
    the_map_is_taken_again_after_a_tenth_of_its_radius();
    what_is_open_is_not_measured_near_a_keyframe_in_a_room();
    a_stage_is_accepted_with_enough_pairs();
    a_keyframe_is_far_enough_from_the_last();
    a_scan_between_keyframes_is_drawn_where_it_fits();
    only_two_odometries_in_a_row_raise_doubt();
    return verdict();
}

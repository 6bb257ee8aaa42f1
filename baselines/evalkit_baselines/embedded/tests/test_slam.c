/* The SLAM on a drive around a ring of corridors: loops, lost tracks, false loops, slices, memory, refused scans. */
#include "check.h"
#include "src/loop_parts.h"
#include "src/slam_parts.h"

#define BEAMS 360u
#define STEP_NS 200000000
#define LAP 150u /* scans */
#define SCANS 190u

static ek_slam slam;
static ek_real ranges[BEAMS], angles[BEAMS];

/* Walls of two rectangles, one in the other, and of boxes in the corridors: x0, y0, x1, y1. */
static const double BOXES[][4] = {{0, 0, 9, 7}, {2, 2, 7, 5}, {3, 0, 3.6, 0.4}, {8.6, 3, 9, 3.9}, {5, 6.6, 5.4, 7}, {0, 2.6, 0.5, 3.1}, {6.2, 0, 7, 0.6}, {1.6, 6.3, 2.6, 7}, {0, 4.6, 0.6, 5.4}};

/* Distance along a beam to the outline of a box. */
static double to_box(const double *box, double x, double y, double c, double s)
{
    double nearest = INFINITY;
    for (int side = 0; side < 4; side++) {
        const int upright = side % 2 == 0;
        const double along = upright ? (box[side] - x) / c : (box[side] - y) / s;
        const double at = upright ? y + along * s : x + along * c;
        const double low = upright ? box[1] : box[0], high = upright ? box[3] : box[2];
        nearest = along > 1e-9 && at >= low && at <= high && along < nearest ? along : nearest;
    }
    return nearest;
}

/* Pose k: along the middle of the ring, turning in the corners. */
static ek_pose pose_at(size_t k)
{
    static const double x[] = {1, 8, 8, 1}, y[] = {1, 1, 6, 6}, half_pi = 1.57079632679489662;
    static const size_t lengths[] = {42u, 33u, 42u, 33u};
    size_t within = k % LAP, side = 0u;
    while (within >= lengths[side]) {
        within -= lengths[side++];
    }
    const double steps = (double)lengths[side] - 6.0, at = (double)within < steps ? (double)within / steps : 1.0;
    const double turn = (double)within > steps ? ((double)within - steps) / 6.0 : 0.0;
    const size_t next = (side + 1u) % 4u;
    const ek_pose pose = {EK_R(x[side] + at * (x[next] - x[side])), EK_R(y[side] + at * (y[next] - y[side])),
                          ek_se2_wrap(EK_R(half_pi * ((double)side + turn)))};
    return pose;
}

/* Fill a sweep seen from pose k, with noise of 1 cm and odometry that turns too far. */
static ek_sweep sweep_at(size_t k, uint64_t *seed)
{
    ek_sweep sweep;
    const ek_pose pose = pose_at(k);
    memset(&sweep, 0, sizeof sweep);
    for (size_t i = 0; i < BEAMS; i++) {
        angles[i] = EK_R(2.0) * EK_PI * (ek_real)i / (ek_real)BEAMS;
        const double c = cos((double)(pose.theta + angles[i])), s = sin((double)(pose.theta + angles[i]));
        double range = INFINITY;
        for (size_t box = 0; box < sizeof BOXES / sizeof *BOXES; box++) {
            const double to = to_box(BOXES[box], (double)pose.x, (double)pose.y, c, s);
            range = to < range ? to : range;
        }
        ranges[i] = EK_R(range) + uniform(seed, -0.01, 0.01);
    }
    sweep.stamp_ns = (int64_t)k * STEP_NS;
    sweep.ranges = ranges;
    sweep.angles = angles;
    sweep.beams = BEAMS;
    sweep.has_odometry = 1;
    sweep.odom_from_base = pose;
    sweep.odom_from_base.theta = ek_se2_wrap(pose.theta + EK_R(1e-4) * (ek_real)k);
    return sweep;
}

static ek_slam_parameters parameters_of(int64_t work)
{
    ek_slam_parameters p = ek_slam_default();
    p.scan.range_min = EK_R(0.05);
    p.points = BEAMS;
    p.keyframes = 300u;
    p.keyframe_points = 80000u;
    p.loops = 8u;
    p.records = 32u;
    p.voxels = p.map_points = 4096u;
    p.loop_points = 12000u;
    p.score_cells = (size_t)256 * 256;
    p.loop.path = EK_R(10.0);
    p.work = work;
    return p;
}

static ek_arena start(const ek_slam_parameters *parameters)
{
    size_t bytes = 0u;
    CHECK(ek_slam_bytes(parameters, &bytes) == EK_OK);
    ek_arena arena = memory_of(bytes);
    CHECK(ek_slam_start(&slam, arena.memory, bytes - 1u, parameters) == EK_TOO_LITTLE_MEMORY);
    CHECK(ek_slam_start(&slam, arena.memory, bytes, parameters) == EK_OK);
    return arena;
}

/* Drive and compare all corrected poses with the true ones; returns the largest number of operations of a scan. */
static uint64_t drive(int64_t work, double tolerance)
{
    static ek_pose odom[SCANS];
    static uint32_t keyframe[SCANS];
    const ek_slam_parameters parameters = parameters_of(work);
    ek_arena arena = start(&parameters);
    uint64_t seed = 7u, most = 0u, accepted = 0u, corrected = 0u;
    for (size_t k = 0; k < SCANS; k++) {
        ek_slam_estimate estimate;
        const ek_sweep sweep = sweep_at(k, &seed);
        CHECK(ek_slam_update(&slam, &sweep, &estimate) == EK_OK && !estimate.lost && !estimate.full);
        odom[k] = estimate.odom_from_base;
        keyframe[k] = estimate.keyframe;
        CHECK(estimate.keyframe + 1u == slam.keyframes.count);
        most = estimate.work > most ? estimate.work : most;
        corrected += (uint64_t)estimate.corrected;
    }
    for (size_t k = 0; k < slam.record_count; k++) {
        const ek_loop_edge *const edge = &slam.record[k].candidate.edge;
        accepted += (uint64_t)slam.record[k].accepted;
        CHECK(edge->first < edge->second);
    }
    CHECK(accepted >= 1u && slam.keyframes.graph.loop_count == accepted && corrected <= accepted);
    for (size_t k = 0; k < SCANS; k++) {
        const ek_pose true_pose = ek_se2_between(pose_at(0u), pose_at(k));
        const ek_pose gap = ek_se2_between(true_pose, ek_slam_correct(&slam, keyframe[k], odom[k]));
        CHECK_NEAR(gap.x, 0.0, tolerance);
        CHECK_NEAR(gap.y, 0.0, tolerance);
    }
    free(arena.memory);
    return most;
}

/* A slow lidar leaves more time for loops; a single gap does not. */
static void work_is_in_proportion_to_the_time_between_scans(void)
{
    static const struct {
        int64_t work, last_ms, before_ms, allowed;
    } cases[] = {
        {200000, 0, 0, 200000},       {200000, 25, 25, 200000},      {200000, 100, 100, 200000},
        {200000, 125, 125, 250000},   {200000, 180, 2000, 360000},   {200000, 2000, 100, 200000},
        {200000, 2000, 2000, 4000000}, {200000, 60000, 60000, 4000000}, {1, 1990, 3000, 19},
        {0, 100, 100, INT64_MAX},     {INT64_MAX, 2000, 2000, INT64_MAX},
    };
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        slam.parameters.work = cases[k].work;
        slam.motion.interval_ns[0] = cases[k].last_ms * 1000000;
        slam.motion.interval_ns[1] = cases[k].before_ms * 1000000;
        CHECK(ek_slam_allowed_work(&slam) == cases[k].allowed);
    }
}

/* Three times 200,000 operations are left while the track is lost, less 12 for each point and iteration. */
static void a_scan_that_is_hard_to_match_leaves_no_work_for_the_search(void)
{
    static const uint64_t matching[] = {0u, 10000u, 50000u, 60000u};
    static const int64_t spare[] = {600000, 480000, 0, 0};
    for (size_t k = 0; k < 4u; k++) {
        slam.matching = matching[k];
        CHECK(ek_slam_spare_work(&slam, 200000) == spare[k]);
    }
    CHECK(ek_slam_spare_work(&slam, INT64_MAX) == INT64_MAX - 720000);
}

static void refused_scans_change_nothing(void)
{
    const ek_slam_parameters parameters = parameters_of(0);
    ek_arena arena = start(&parameters);
    ek_slam_estimate first, second;
    uint64_t seed = 9u;
    for (size_t k = 0; k < 30u; k++) {
        const ek_sweep sweep = sweep_at(k, &seed);
        CHECK(ek_slam_update(&slam, &sweep, &first) == EK_OK);
    }
    const ek_slam before = slam;
    ek_sweep sweep = sweep_at(29u, &seed);
    CHECK(ek_slam_update(&slam, &sweep, &second) == EK_OUT_OF_RANGE); /* the same stamp again */
    sweep = sweep_at(30u, &seed);
    sweep.odom_from_base.y = (ek_real)NAN;
    CHECK(ek_slam_update(&slam, &sweep, &second) == EK_NOT_FINITE);
    sweep = sweep_at(30u, &seed);
    sweep.beams = BEAMS + 1u;
    CHECK(ek_slam_update(&slam, &sweep, &second) == EK_TOO_MANY_POINTS);
    sweep.beams = BEAMS;
    sweep.time_increment_ns = 1000;
    sweep.has_motion = 1;
    sweep.start_from_end.x = EK_R(5e5);
    CHECK(ek_slam_update(&slam, &sweep, &second) == EK_OUT_OF_RANGE);
    CHECK(ek_slam_update(&slam, NULL, &second) == EK_NULL_POINTER);
    CHECK(slam.keyframes.count == before.keyframes.count && slam.motion.stamp_ns == before.motion.stamp_ns);
    CHECK(memcmp(&slam.motion.start_from_base, &before.motion.start_from_base, sizeof before.motion.start_from_base) == 0);
    free(arena.memory);
}

static ek_pose pose_of(double x, double y, double theta)
{
    const ek_pose pose = {EK_R(x), EK_R(y), EK_R(theta)};
    return pose;
}

/* One scan of a drive: seen from pose `at`, as scan number `k`, without odometry. */
static ek_slam_estimate step_without_odometry(size_t k, size_t at, uint64_t *seed)
{
    ek_slam_estimate estimate;
    ek_sweep sweep = sweep_at(at, seed);
    sweep.stamp_ns = (int64_t)k * STEP_NS;
    sweep.has_odometry = 0;
    CHECK(ek_slam_update(&slam, &sweep, &estimate) == EK_OK);
    return estimate;
}

static void check_near_truth(size_t at, ek_pose start_from_base, double tolerance)
{
    const ek_pose gap = ek_se2_between(ek_se2_between(pose_at(0u), pose_at(at)), start_from_base);
    CHECK_NEAR(gap.x, 0.0, tolerance);
    CHECK_NEAR(gap.y, 0.0, tolerance);
    CHECK_NEAR(gap.theta, 0.0, tolerance);
}

/* The robot is carried from pose 119 to pose 20 and not told: the track is lost at once, and found again by a loop
 * between the two parts of the drive. */
static void a_carried_robot_finds_its_place(void)
{
    const ek_slam_parameters parameters = parameters_of(0);
    ek_arena arena = start(&parameters);
    uint64_t seed = 7u;
    unsigned again = 0u;
    for (size_t k = 0; k < 200u; k++) {
        const size_t at = k < 120u ? k : k - 100u;
        const ek_slam_estimate estimate = step_without_odometry(k, at, &seed);
        CHECK(estimate.lost == (k == 120u) && !estimate.set_aside);
        if (k < 120u || k > 180u) {
            check_near_truth(at, estimate.start_from_base, 0.03);
        }
    }
    for (size_t k = 0; k < slam.record_count; k++) {
        const ek_loop_record *const record = slam.record + k;
        again += (unsigned)record->found_again;
        CHECK(record->section == slam.keyframes.section[record->candidate.edge.second]);
        CHECK(!record->found_again || (record->accepted && !record->candidate.is_local));
    }
    CHECK(again == 1u && slam.keyframes.section[slam.keyframes.count - 1u] == 1u);
    free(arena.memory);
}

/* People cover the lidar for a second: its pose goes on by the wheels, and the map and the track stay as they are. After
 * two seconds the track is lost. */
static void a_covered_lidar_keeps_its_track_for_a_while(void)
{
    const ek_slam_parameters parameters = parameters_of(0);
    ek_arena arena = start(&parameters);
    uint64_t seed = 7u;
    for (size_t k = 0; k < 51u; k++) {
        const int covered = (k >= 20u && k < 25u) || k >= 40u;
        ek_sweep sweep = sweep_at(k, &seed);
        for (size_t i = 0; covered && i < BEAMS; i++) {
            ranges[i] = EK_R(0.65) + uniform(&seed, -0.35, 0.35);
        }
        ek_slam_estimate estimate;
        CHECK(ek_slam_update(&slam, &sweep, &estimate) == EK_OK);
        CHECK(estimate.set_aside == (covered && k < 50u) && estimate.lost == (k == 50u));
        if (k < 50u) {
            check_near_truth(k, estimate.start_from_base, 0.05);
        }
    }
    free(arena.memory);
}

/* Points in the map. */
static uint64_t points_drawn(void)
{
    const ek_voxel_map *const map = &slam.maps[slam.drawn];
    uint64_t points = 0u;
    for (size_t k = 0; k < map->count; k++) {
        points += map->voxel[k].points;
    }
    return points;
}

/* The wheels turn by 3 deg within the sweeps of scans 10, 20, 30, 60 and `last`, and not between scans. Such a scan is no
 * keyframe and does not enter the map. Where the odometry is good, and was right over two such turns, it is set aside: scan 60, but
 * not 30, before it is known how good the odometry is, nor one directly after 60, nor one after the odometry was wrong over
 * the turn of scan 60, by `wrong` (rad). */
static void a_scan_within_which_the_robot_turns_unevenly_is_set_aside(size_t last, double wrong)
{
    const ek_slam_parameters parameters = parameters_of(0);
    ek_arena arena = start(&parameters);
    uint64_t seed = 7u;
    for (size_t k = 0; k < 68u; k++) {
        const int uneven = k == 10u || k == 20u || k == 30u || k == 60u || k == last;
        const size_t keyframes = slam.keyframes.count;
        const uint64_t drawn = points_drawn();
        ek_sweep sweep = sweep_at(k, &seed);
        sweep.time_increment_ns = uneven ? STEP_NS / (int64_t)(BEAMS - 1u) : 0;
        sweep.has_motion = uneven;
        sweep.start_from_end = pose_of(0.0, 0.0, 0.052);
        sweep.odom_from_base.theta += k > 60u ? EK_R(wrong) : EK_R(0.0);
        ek_slam_estimate estimate;
        CHECK(ek_slam_update(&slam, &sweep, &estimate) == EK_OK);
        CHECK(estimate.set_aside == (k == 60u) && estimate.has_scan_to_map == (k != 0u && k != 60u));
        CHECK((k > 20u || slam.uneven.right == (k > 10u)) && (k != 61u || !(wrong > 0.0) || slam.uneven.right == 0));
        CHECK(!uneven || k == 61u || (slam.keyframes.count == keyframes && points_drawn() == drawn));
    }
    free(arena.memory);
}

/* By how much the turn of a sweep of 100 ms differs from 0.1 rad, that at the rate of the 200 ms before; 0 where that is not
 * known, or not above 1 deg. */
static void the_unevenness_of_a_turn_is_that_of_a_hand_calculation(void)
{
    const ek_slam_parameters parameters = parameters_of(0);
    ek_arena arena = start(&parameters);
    uint64_t seed = 7u;
    ek_slam_estimate estimate;
    ek_sweep sweep = sweep_at(0u, &seed);
    CHECK(ek_slam_update(&slam, &sweep, &estimate) == EK_OK);
    sweep.stamp_ns += STEP_NS;
    sweep.time_increment_ns = STEP_NS / 2 / (int64_t)(BEAMS - 1u); /* half of the time */
    sweep.has_motion = 1;
    sweep.odom_from_base.theta += EK_R(0.2);
    static const double within[] = {0.09, 0.11, 0.15, 0.06}, by[] = {0.0, 0.0, 0.05, 0.04};
    for (size_t k = 0; k < 4u; k++) {
        sweep.start_from_end = pose_of(0.0, 0.0, within[k]);
        CHECK_NEAR(ek_slam_unevenness(&slam, &sweep), by[k], 1e-4);
    }
    sweep.has_motion = 0;
    CHECK_NEAR(ek_slam_unevenness(&slam, &sweep), 0.0, 0.0);
    sweep.has_motion = 1;
    slam.motion.has_last_odometry = 0;
    CHECK_NEAR(ek_slam_unevenness(&slam, &sweep), 0.0, 0.0);
    slam.motion.has_last_odometry = 1;
    slam.parameters.deskew = 0;
    CHECK_NEAR(ek_slam_unevenness(&slam, &sweep), 0.0, 0.0);
    free(arena.memory);
}

/* A usual error of 0.02 m: a match of 0.04 m is not doubted, one of 0.06 m by half, and wholly from 0.08 m or with pairs
 * for less than 80 % of the points on. Its share, squared, of the squared gap to the prediction is the variance. */
static void a_step_is_doubted_where_its_matches_fit_poorly(void)
{
    static const double errors[] = {0.02, 0.04, 0.06, 0.08, 0.5, 0.01}, shares[] = {0.0, 0.0, 0.5, 1.0, 1.0, 1.0};
    const ek_slam_parameters parameters = parameters_of(0);
    ek_arena arena = start(&parameters);
    const ek_pose predicted = pose_of(1.0, 1.0, 0.1);
    slam.scan.count = 100u;
    for (size_t k = 0; k < 6u; k++) {
        const ek_match match = {pose_of(0.0, 0.0, 0.0), 1, 5, k < 5u ? 80 : 79, EK_R(errors[k]), 0u};
        ek_match none = match;
        none.inliers = 0;
        slam.usual_error = EK_R(0.02);
        slam.usual_gap = EK_R(0.5); /* the gap is usual */
        slam.doubt.position = slam.doubt.heading = EK_R(1.0);
        ek_slam_doubt(&slam, &predicted, pose_of(1.3, 1.4, 0.3), &match);
        ek_slam_doubt(&slam, NULL, pose_of(9.0, 9.0, 0.3), &none); /* without odometry no gap is doubted */
        CHECK_NEAR((double)slam.doubt.position - 1.0, 0.25 * shares[k] * shares[k], 1e-6);
        CHECK_NEAR((double)slam.doubt.heading - 1.0, 0.04 * shares[k] * shares[k], 1e-6);
    }
    slam.usual_error = EK_R(0.0); /* the first match is the usual one */
    const ek_pose origin = pose_of(0.0, 0.0, 0.0);
    const ek_match first = {pose_of(0.0, 0.0, 0.0), 1, 5, 100, EK_R(0.3), 0u};
    ek_slam_doubt(&slam, &origin, pose_of(1.0, 0.0, 0.0), &first);
    CHECK_NEAR((double)slam.doubt.position, 1.25, 1e-6); /* of the last one above */
    CHECK_NEAR((double)slam.usual_error, 0.3, 1e-7);
    slam.usual_error = EK_R(0.1); /* of an error that is larger by far, 0.2 counts */
    ek_slam_doubt(&slam, NULL, origin, &first);
    CHECK_NEAR((double)slam.usual_error, 0.102, 1e-7);
    free(arena.memory);
}

/* After a step of 0.6 m odometry is thought to be no better than 0.04 m: a gap of 0.12 m is not doubted, one of 0.18 m by half,
 * and wholly from 0.24 m on. Of a gap that is larger by far twice the usual one counts for what is usual. */
static void a_step_is_doubted_where_its_matches_are_far_from_the_odometry(void)
{
    static const double gaps[] = {0.12, 0.18, 0.24, 0.6}, shares[] = {0.0, 0.5, 1.0, 1.0};
    const ek_slam_parameters parameters = parameters_of(0);
    ek_arena arena = start(&parameters);
    const ek_pose predicted = pose_of(0.0, 0.6, 0.0);
    const ek_match match = {pose_of(0.0, 0.0, 0.0), 1, 5, 100, EK_R(0.02), 0u};
    slam.scan.count = 100u;
    for (size_t k = 0; k < 4u; k++) {
        slam.usual_error = EK_R(0.02);
        slam.usual_gap = EK_R(0.0);
        slam.doubt.position = slam.doubt.heading = EK_R(0.0);
        ek_slam_doubt(&slam, &predicted, pose_of(gaps[k], 0.6, 0.3), &match);
        CHECK_NEAR((double)slam.doubt.position, shares[k] * shares[k] * gaps[k] * gaps[k], 1e-6);
        CHECK_NEAR((double)slam.doubt.heading, 0.0, 1e-12);
        CHECK_NEAR((double)slam.usual_gap, 0.08 / 50.0, 1e-7);
    }
    slam.usual_gap = EK_R(0.1); /* then 0.3 m are not doubted */
    slam.doubt.position = EK_R(0.0);
    ek_slam_doubt(&slam, &predicted, pose_of(0.29, 0.6, 0.0), &match);
    CHECK_NEAR((double)slam.doubt.position, 0.0, 1e-12);
    free(arena.memory);
}

/* Of 100 points: within 0.3 m and 20 degrees of the guess any match is accepted where matches were usually near the odometry,
 * and within 0.5 m and 36 degrees where nothing is known; beyond them one that has converged to an error below 0.04 m with 90
 * of them. A match of 39 points is never accepted beside good odometry, unless a scan has fewer than 120 usually: here 60. */
static void a_match_far_from_the_odometry_must_be_clear(void)
{
    static const struct {
        double x, y, turn_deg, error;
        int32_t converged, inliers, strict, wide;
        size_t points;
    } cases[] = {{0.3, 0.0, 0.0, 0.5, 0, 0, 1, 1, 100u},     {0.0, 0.3, 19.9, 0.5, 0, 0, 1, 1, 100u},
                 {0.25, 0.25, 0.0, 0.5, 1, 100, 0, 1, 100u}, {0.0, 0.0, 20.1, 0.5, 1, 100, 0, 1, 100u},
                 {0.5, 0.0, 35.9, 0.5, 1, 100, 0, 1, 100u},  {0.4, 0.4, 0.0, 0.5, 1, 100, 0, 0, 100u},
                 {0.0, 0.0, 36.1, 0.5, 1, 100, 0, 0, 100u},  {0.0, 0.0, 0.0, 0.5, 0, 0, 1, 1, 40u},
                 {5.0, 5.0, 90.0, 0.03, 1, 90, 1, 1, 100u},  {5.0, 5.0, 90.0, 0.03, 1, 89, 0, 0, 100u},
                 {0.0, 0.0, 90.0, 0.05, 1, 90, 0, 0, 100u},  {5.0, 5.0, 0.0, 0.03, 0, 90, 0, 0, 100u},
                 {0.0, 0.0, 0.0, 0.03, 1, 39, 0, 1, 39u}};
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        const ek_pose answer = pose_of(cases[k].x, cases[k].y, cases[k].turn_deg * (double)EK_PI / 180.0);
        const ek_match match = {answer, cases[k].converged, 5, cases[k].inliers, EK_R(cases[k].error), 0u};
        const ek_pose guess = pose_of(0.0, 0.0, 0.0);
        slam.usual_error = EK_R(0.0);
        slam.usual_points = EK_R(120.0);
        for (size_t known = 0; known < 4u; known++) { /* good odometry; nothing known; bad odometry; none */
            slam.compared = known == 1u ? 49u : 50u;
            slam.usual_gap = slam.usual_turn = known == 2u ? EK_R(1.0) : EK_R(0.0);
            ek_gate gate = ek_slam_gate(&slam, known < 3u, guess);
            const int expected = known == 3u || (known == 0u ? cases[k].strict : cases[k].wide);
            CHECK(ek_slam_accepts(&gate, cases[k].points, guess, answer, &match) == expected);
        }
    }
    const ek_pose guess = pose_of(0.0, 0.0, 0.0);
    const ek_match match = {guess, 1, 5, 19, EK_R(0.03), 0u};
    slam.usual_gap = slam.usual_turn = EK_R(0.0);
    slam.usual_points = EK_R(60.0);
    ek_gate sparse = ek_slam_gate(&slam, 1, guess);
    CHECK(ek_slam_accepts(&sparse, 20u, guess, guess, &match) && !ek_slam_accepts(&sparse, 19u, guess, guess, &match));
}

/* Half as far: a match of more than four times the usual error, 0.02 m, with pairs for less than 80 of 100 points. */
static void a_match_that_fits_poorly_must_be_nearer_to_the_odometry(void)
{
    static const struct {
        double x, turn_deg, error;
        int32_t inliers, accepted;
    } cases[] = {{0.24, 17.9, 0.09, 79, 1}, {0.26, 0.0, 0.09, 79, 0}, {0.0, 18.1, 0.09, 79, 0},
                 {0.49, 35.9, 0.07, 79, 1}, {0.49, 35.9, 0.09, 80, 1}, {0.51, 0.0, 0.07, 79, 0}};
    slam.compared = 0u;
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        const ek_pose answer = pose_of(cases[k].x, 0.0, cases[k].turn_deg * (double)EK_PI / 180.0), guess = pose_of(0.0, 0.0, 0.0);
        const ek_match match = {answer, 1, 5, cases[k].inliers, EK_R(cases[k].error), 0u};
        slam.usual_error = EK_R(0.02);
        ek_gate gate = ek_slam_gate(&slam, 1, guess);
        CHECK(ek_slam_accepts(&gate, 100u, guess, answer, &match) == cases[k].accepted);
    }
    slam.usual_error = EK_R(0.0);
}

/* Usually 0.02 m and 0.02 rad from the odometry, or beside good odometry after a step of 0.4 m and 0.2 rad: 0.4 m and 0.4 rad are
 * accepted, and more is not. */
static void a_match_is_accepted_up_to_twenty_times_its_usual_distance_or_a_quarter_of_the_step(void)
{
    static const double gaps[][3] = {{0.39, 0.39, 1.0}, {0.41, 0.0, 0.0}, {0.0, 0.41, 0.0}};
    slam.compared = 50u;
    slam.usual_error = EK_R(0.0);
    for (size_t k = 0; k < 6u; k++) {
        slam.usual_gap = slam.usual_turn = k < 3u ? EK_R(0.02) : EK_R(0.0);
        ek_gate gate = ek_slam_gate(&slam, 1, k < 3u ? pose_of(0.0, 0.0, 0.0) : pose_of(0.24, -0.32, -0.2));
        const ek_pose answer = pose_of(0.0, gaps[k % 3u][0], gaps[k % 3u][1]);
        const ek_match match = {answer, 1, 5, 100, EK_R(0.1), 0u};
        CHECK(ek_slam_accepts(&gate, 100u, pose_of(0.0, 0.0, 0.0), answer, &match) == (gaps[k % 3u][2] > 0.5));
    }
}

/* Usually with an error of 0.02 m and beside good odometry: once a match of a scan is not doubted, and within 3 cm of its guess,
 * another one with more than twice that error, or with pairs for fewer than 80 of 100 points, must be so, too. */
static void a_doubted_match_stays_where_odometry_and_the_match_before_agree(void)
{
    static const struct {
        double y_before, error_before, x, error;
        int32_t inliers, accepted;
        uint32_t compared;
    } cases[] = {{0.029, 0.03, 0.029, 0.045, 100, 1, 50u}, {0.029, 0.03, 0.031, 0.045, 100, 0, 50u},
                 {0.029, 0.03, 0.031, 0.039, 80, 1, 50u},  {0.029, 0.03, 0.031, 0.039, 79, 0, 50u},
                 {0.029, 0.041, 0.031, 0.045, 100, 1, 50u}, {0.031, 0.03, 0.031, 0.045, 100, 1, 50u},
                 {0.029, 0.03, 0.031, 0.045, 100, 1, 49u}};
    const ek_pose guess = pose_of(0.0, 0.0, 0.0);
    slam.usual_error = EK_R(0.02);
    slam.usual_gap = slam.usual_turn = EK_R(0.0);
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        slam.compared = cases[k].compared;
        ek_gate gate = ek_slam_gate(&slam, 1, guess);
        const ek_match before = {guess, 1, 5, 100, EK_R(cases[k].error_before), 0u};
        const ek_match match = {pose_of(cases[k].x, 0.0, 0.0), 0, 5, cases[k].inliers, EK_R(cases[k].error), 0u};
        CHECK(ek_slam_accepts(&gate, 100u, guess, pose_of(0.0, cases[k].y_before, 0.0), &before));
        CHECK(ek_slam_accepts(&gate, 100u, guess, match.target_from_source, &match) == cases[k].accepted);
    }
    slam.usual_error = EK_R(0.0);
    slam.compared = 50u; /* and no error is usual */
    ek_gate unknown = ek_slam_gate(&slam, 1, guess);
    const ek_match match = {pose_of(0.031, 0.0, 0.0), 0, 5, 100, EK_R(0.045), 0u};
    CHECK(ek_slam_accepts(&unknown, 100u, guess, guess, &match) && unknown.sure);
    CHECK(ek_slam_accepts(&unknown, 100u, guess, match.target_from_source, &match) && !unknown.sure);
}

/* A standing robot, 0.1 m ahead of itself by its odometry, which was good before: a scan of 39 points says nothing against it. */
static void the_gate_accepts_no_match_of_few_points_against_good_odometry(void)
{
    static const size_t beams[] = {39u, 40u};
    ek_slam_parameters p = parameters_of(0);
    for (size_t few = 0; few < 2u; few++) {
        ek_arena arena = start(&p);
        uint64_t seed = 7u;
        ek_slam_estimate estimate;
        slam.compared = 50u;
        slam.usual_points = EK_R(120.0);
        for (size_t k = 0; k < 2u; k++) {
            ek_sweep sweep = sweep_at(0u, &seed);
            for (size_t i = 0; i < beams[few]; i++) {
                ranges[i] = ranges[9u * i];
                angles[i] = angles[9u * i];
            }
            sweep.beams = beams[few];
            sweep.stamp_ns = (int64_t)k * STEP_NS;
            sweep.odom_from_base = pose_of(0.1 * (double)k, 0.0, 0.0);
            CHECK(ek_slam_update(&slam, &sweep, &estimate) == EK_OK);
        }
        CHECK(estimate.scan_to_map_accepted == (int32_t)few && estimate.scan_to_scan_accepted == (int32_t)few);
        CHECK_NEAR(estimate.odom_from_base.x, few ? 0.0 : 0.1, few ? 0.03 : 1e-6);
        free(arena.memory);
    }
}

static ek_arena lasting; /* of the last drive_and_count */

/* Drive the ring; counts how many candidates had each outcome, and at index 7 how many were accepted. */
static void drive_and_count(const ek_slam_parameters *parameters, size_t scans, unsigned counts[8])
{
    free(lasting.memory);
    lasting = start(parameters);
    uint64_t seed = 7u;
    memset(counts, 0, 8u * sizeof *counts);
    for (size_t k = 0; k < scans; k++) {
        ek_slam_estimate estimate;
        const ek_sweep sweep = sweep_at(k, &seed);
        CHECK(ek_slam_update(&slam, &sweep, &estimate) == EK_OK && !estimate.lost);
        check_near_truth(k, estimate.start_from_base, 0.05);
    }
    for (size_t k = 0; k < slam.record_count; k++) {
        counts[slam.record[k].candidate.outcome]++;
        counts[7] += (unsigned)slam.record[k].accepted;
    }
    CHECK(counts[7] == slam.keyframes.graph.loop_count);
}

/* Each bound of the finder, set so that nothing passes it, gives its own outcome and no loop. */
static void each_bound_refuses_candidates_with_its_own_outcome(void)
{
    unsigned counts[8];
    ek_slam_parameters p = parameters_of(0);
    p.loop.degenerate = EK_R(0.0);
    drive_and_count(&p, SCANS, counts);
    CHECK(counts[EK_LOOP_DEGENERATE] >= 1u && counts[EK_LOOP_PASSED] == 0u && counts[7] == 0u);
    p = parameters_of(0);
    p.loop.gate = EK_R(0.0);
    p.loop.ambiguity = EK_R(0.5);
    p.drift.sigma = EK_R(0.3); /* windows of metres: other motions in it fit half as well, and none is possible */
    drive_and_count(&p, SCANS, counts);
    CHECK(counts[EK_LOOP_CHI] >= 1u && counts[EK_LOOP_PASSED] == 0u && counts[EK_LOOP_AMBIGUOUS] == 0u);
    p.loop.gate = EK_R(1e6); /* and now all are */
    drive_and_count(&p, SCANS, counts);
    CHECK(counts[EK_LOOP_AMBIGUOUS] >= 1u && counts[EK_LOOP_CHI] == 0u);
    p = parameters_of(0);
    p.loop.overlap = EK_R(1.0);
    p.loop.near = EK_R(0.001);
    drive_and_count(&p, SCANS, counts);
    CHECK(counts[EK_LOOP_OVERLAP] >= 1u && counts[EK_LOOP_PASSED] == 0u);
    p = parameters_of(0);
    p.loop_points = 40u; /* no keyframe fits */
    drive_and_count(&p, SCANS, counts);
    CHECK(counts[EK_LOOP_FEW_POINTS] >= 1u && counts[EK_LOOP_FEW_POINTS] == slam.record_count);
    p.loop_points = 700u; /* some keyframes on either side, and not all within 3 m */
    drive_and_count(&p, SCANS, counts);
    CHECK(counts[7] >= 1u && counts[EK_LOOP_FEW_POINTS] == 0u);
}

static ek_loop_candidate find(int64_t slice)
{
    slam.finder.tried = 0;
    ek_work work = ek_work_make(INT64_MAX);
    CHECK(ek_loop_finder_begin(&slam.finder, &slam.keyframes, NULL, 1, &work));
    do {
        work = ek_work_make(slice);
    } while (!ek_loop_finder_work(&slam.finder, &slam.keyframes, &work));
    return slam.finder.candidate;
}

/* A candidate judged in the smallest slices is to the bit the one judged at once, with rivals and without. */
static void slices_change_no_bit_of_a_candidate(void)
{
    unsigned counts[8];
    ek_slam_parameters p = parameters_of(0);
    p.loop.gate = EK_R(0.0);
    p.loop.ambiguity = EK_R(0.5);
    for (int wide = 0; wide < 2; wide++) {
        p.drift.sigma = EK_R(wide ? 0.3 : 0.02);
        drive_and_count(&p, SCANS, counts);
        const ek_loop_candidate whole = find(INT64_MAX), slices = find(1);
        CHECK(whole.outcome == EK_LOOP_CHI && slices.outcome == whole.outcome && slices.is_local == whole.is_local);
        CHECK(slices.edge.first == whole.edge.first && slices.edge.second == whole.edge.second);
        CHECK(memcmp(&slices.edge.first_from_second, &whole.edge.first_from_second, sizeof(ek_pose)) == 0);
        CHECK(memcmp(&slices.edge.information, &whole.edge.information, sizeof(ek_sym3)) == 0);
        CHECK(memcmp(slices.number, whole.number, sizeof whole.number) == 0);
    }
}

/* Five keyframes 10 m apart, then a lost track: each of them is looked at in turn, and then the first again. Where the robot
 * seems to be near the third one, that one is looked at two times of five. */
static void a_lost_robot_is_looked_for_at_all_places_in_turn(void)
{
    static const double steps[] = {100.0, -18.0};
    static const uint32_t expected[2][12] = {{0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 0, 1}, {2, 0, 2, 1, 2, 2, 3, 2, 4, 0, 2, 1}};
    const ek_openness closed = {.x = EK_R(1.0), .ratio = EK_R(1.0)};
    const ek_real point[] = {EK_R(1.0), EK_R(0.0)};
    const ek_slam_parameters p = parameters_of(0);
    const ek_doubt none = {EK_R(0.0), EK_R(0.0)};
    for (size_t near = 0; near < 2u; near++) {
        ek_arena arena = start(&p);
        ek_work work = ek_work_make(INT64_MAX);
        for (size_t k = 0; k < 6u; k++) {
            const ek_pose step = pose_of(k == 0u ? 0.0 : k < 5u ? 10.0 : steps[near], 0.0, 0.0);
            const ek_step_kind kind = k < 5u ? EK_STEP_MATCHED : EK_STEP_UNKNOWN;
            CHECK(ek_keyframes_add(&slam.keyframes, point, 1u, AT_BASE, step, kind, &closed, none, &work) == EK_OK);
        }
        for (size_t k = 0; k < 12u; k++) {
            slam.finder.tried = 0;
            CHECK(ek_loop_finder_begin(&slam.finder, &slam.keyframes, NULL, 0, &work));
            CHECK(slam.finder.candidate.edge.first == expected[near][k] && slam.finder.candidate.edge.second == 5u);
        }
        free(arena.memory);
    }
}

/* Five keyframes 10 m apart, a step of the wheels alone back to near the third one, and two keyframes more, the last at the
 * place of the sixth. Of five turns three are for the third keyframe, by the wheels in the first and the fourth, the second
 * is for the next of all places, and the last for the sixth keyframe, which is connected. */
static void after_a_step_of_the_wheels_alone_five_turns_look_at_four_kinds_of_places(void)
{
    static const double steps[] = {0.0, 10.0, 10.0, 10.0, 10.0, -18.0, 8.0, -8.0};
    static const uint32_t expected[] = {2, 0, 2, 2, 5, 2, 1, 2, 2, 5};
    static const int known[] = {1, 0, 0, 1, 1};
    const ek_openness closed = {.x = EK_R(1.0), .ratio = EK_R(1.0)};
    const ek_real point[] = {EK_R(1.0), EK_R(0.0)};
    const ek_slam_parameters p = parameters_of(0);
    const ek_doubt none = {EK_R(0.0), EK_R(0.0)};
    ek_arena arena = start(&p);
    ek_work work = ek_work_make(INT64_MAX);
    for (size_t k = 0; k < 8u; k++) {
        const ek_step_kind kind = k == 5u ? EK_STEP_MEASURED : EK_STEP_MATCHED;
        CHECK(ek_keyframes_add(&slam.keyframes, point, 1u, AT_BASE, pose_of(steps[k], 0.0, 0.0), kind, &closed, none, &work) == EK_OK);
    }
    for (size_t k = 0; k < 10u; k++) {
        slam.finder.tried = 0;
        CHECK(ek_loop_finder_begin(&slam.finder, &slam.keyframes, NULL, 1, &work));
        CHECK(slam.finder.candidate.edge.first == expected[k] && slam.finder.candidate.edge.second == 7u);
        CHECK(slam.finder.candidate.known == known[k % 5u]);
    }
    free(arena.memory);
}

/* In slices of 2,000 operations a search takes many scans: none of them is disturbed by it. A lost track drops it. */
static void a_search_in_small_slices_is_dropped_by_a_lost_track(void)
{
    unsigned counts[8];
    ek_slam_parameters p = parameters_of(2000);
    p.loop.ambiguity = EK_R(0.5);
    p.drift.sigma = EK_R(0.3);
    drive_and_count(&p, SCANS, counts);
    p.loop.path = EK_R(1e6);
    ek_arena arena = start(&p);
    uint64_t seed = 7u;
    for (size_t k = 0; k < 120u; k++) {
        CHECK(!step_without_odometry(k, k, &seed).lost);
    }
    slam.task = EK_TASK_FIND;
    slam.finder.phase = EK_FINDER_DRAW;
    CHECK(step_without_odometry(120u, 20u, &seed).lost);
    CHECK(slam.task == EK_TASK_IDLE && slam.finder.phase == EK_FINDER_IDLE && slam.record_count == 0u);
    CHECK(slam.keyframes.section[slam.keyframes.count - 1u] == 1u && slam.waiting_count == 0u);
    ek_work some = ek_work_make(1000);
    CHECK(!ek_loop_finder_work(&slam.finder, &slam.keyframes, &some) && some.done == 0u); /* nothing in work */
    free(arena.memory);
}

/* Without quick acceptance a loop waits for a second one that agrees, not farther than 6 m behind it. */
static void a_loop_waits_for_another_that_agrees(void)
{
    unsigned counts[8];
    ek_slam_parameters p = parameters_of(0);
    p.loop.quick_gate = EK_R(0.0);
    drive_and_count(&p, SCANS, counts);
    CHECK(counts[7] >= 1u);
    size_t first = 0u;
    while (first < slam.record_count && slam.record[first].candidate.outcome != EK_LOOP_PASSED) {
        first++;
    }
    CHECK(first < slam.record_count && slam.record[first].unconfirmed && !slam.record[first].accepted);
    p.loop.spacing = EK_R(6.5);
    drive_and_count(&p, SCANS + LAP, counts);
    CHECK(counts[EK_LOOP_PASSED] >= 5u && counts[7] == 0u && slam.waiting_count == 4u);
    for (size_t k = 0; k < slam.record_count; k++) {
        CHECK(slam.record[k].unconfirmed == (slam.record[k].candidate.outcome == EK_LOOP_PASSED));
    }
}

/* Memory that runs out ends what it is for, and nothing else. */
static void memory_that_is_used_up_costs_only_what_it_was_for(void)
{
    unsigned counts[8];
    ek_slam_parameters p = parameters_of(0);
    p.loops = 1u;
    p.loop.spacing = EK_R(0.5);
    drive_and_count(&p, SCANS, counts);
    unsigned no_room = 0u;
    for (size_t k = 0; k < slam.record_count; k++) {
        no_room += (unsigned)slam.record[k].no_room;
    }
    CHECK(counts[7] == 1u && no_room >= 1u && no_room == counts[EK_LOOP_PASSED] - 1u);
    p.loops = 8u;
    p.records = 1u;
    drive_and_count(&p, SCANS, counts);
    CHECK(slam.record_count == 1u && slam.unrecorded >= 1u && counts[7] <= 1u);

    p = parameters_of(0);
    p.keyframes = 20u;
    ek_arena arena = start(&p);
    uint64_t seed = 7u;
    for (size_t k = 0; k < 60u; k++) {
        ek_slam_estimate estimate;
        const ek_sweep sweep = sweep_at(k, &seed);
        CHECK(ek_slam_update(&slam, &sweep, &estimate) == EK_OK);
        CHECK(!estimate.full || slam.keyframes.count == 20u);
        check_near_truth(k, estimate.start_from_base, 0.05);
    }
    CHECK(slam.full && slam.record_count == 0u);
    free(arena.memory);
}

/* Close a loop between two keyframes as if the finder had accepted it. */
static void close_by_hand(uint32_t first, uint32_t second, ek_pose motion, double information)
{
    const ek_real i = EK_R(information);
    const ek_sym3 weights = {i, EK_R(0.0), EK_R(0.0), i, EK_R(0.0), i};
    const ek_loop_edge edge = {first, second, motion, weights, EK_R(1.0)};
    ek_loop_record *const record = slam.record + slam.record_count;
    memset(record, 0, sizeof *record);
    record->candidate.edge = edge;
    record->accepted = 1;
    slam.record_of_loop[slam.keyframes.graph.loop_count] = (uint32_t)slam.record_count++;
    CHECK(ek_pose_graph_close(&slam.keyframes.graph, &edge) == EK_OK);
}

static ek_pose between_keyframes(uint32_t first, uint32_t second)
{
    const ek_pose *const pose = slam.keyframes.graph.pose;
    return ek_se2_between(pose[first], pose[second]);
}

/* Optimise; while it is in doubt which loops contradict the others, all count alike. Returns how many slices that took. */
static unsigned solve(int64_t slice)
{
    unsigned doubted = 0u;
    ek_slam_solve(&slam);
    while (slam.task != EK_TASK_IDLE) {
        ek_work work = ek_work_make(slice);
        ek_slam_work(&slam, &work);
        for (size_t l = 0; slam.task == EK_TASK_DOUBT && l < slam.keyframes.graph.loop_count; l++) {
            CHECK_NEAR(slam.keyframes.graph.loop[l].weight, 1.0, 0.0);
        }
        doubted += slam.task == EK_TASK_DOUBT;
    }
    return doubted;
}

/* Four true loops and two that are wrong by metres: those are withdrawn, and the poses stay where they were. */
static void false_loops_are_withdrawn(int64_t slice)
{
    ek_slam_parameters p = parameters_of(0);
    p.loop.path = EK_R(1e6); /* the finder finds none */
    ek_arena arena = start(&p);
    uint64_t seed = 7u;
    for (size_t k = 0; k < 100u; k++) {
        step_without_odometry(k, k, &seed);
    }
    const uint32_t last = (uint32_t)slam.keyframes.count - 1u;
    const ek_pose before = between_keyframes(0u, last);
    for (uint32_t k = 0; k < 4u; k++) {
        close_by_hand(k, last - k, between_keyframes(k, last - k), 1e4);
        if (k < 2u) {
            const ek_pose lie = ek_se2_compose(between_keyframes(2u * k, last - 5u), pose_of(1.0 + k, -2.0, 0.7));
            close_by_hand(2u * k, last - 5u, lie, 1e4);
        }
    }
    CHECK(solve(slice) >= 1u || slice == INT64_MAX);
    CHECK(slam.keyframes.graph.loop_count == 4u);
    for (size_t k = 0; k < 6u; k++) {
        const int lie = k == 1u || k == 3u;
        CHECK(slam.record[k].withdrawn == lie && slam.record[k].accepted == !lie);
    }
    for (size_t k = 0; k < 4u; k++) {
        CHECK(slam.record[slam.record_of_loop[k]].accepted && slam.keyframes.graph.loop[k].weight >= EK_R(1.0));
    }
    const ek_pose moved = ek_se2_between(before, between_keyframes(0u, last));
    CHECK_NEAR(moved.x, 0.0, 0.002);
    CHECK_NEAR(moved.y, 0.0, 0.002);
    free(arena.memory);
}

/* A loop 0.2 m off, far more certain than the steps, moves the last keyframe by 0.2 m: a correction. The loop before it
 * moved nothing, and one that would lead out of the world is taken away. */
static void a_certain_loop_corrects_and_an_impossible_one_is_taken_away(void)
{
    ek_slam_parameters p = parameters_of(0);
    p.loop.path = EK_R(1e6);
    p.drift.sigma = EK_R(1e5);
    p.drift.sigma_theta = EK_R(1.0);
    ek_arena arena = start(&p);
    uint64_t seed = 7u;
    for (size_t k = 0; k < 60u; k++) {
        step_without_odometry(k, k, &seed);
    }
    const uint32_t last = (uint32_t)slam.keyframes.count - 1u;
    slam.corrected = 0;
    close_by_hand(0u, last, between_keyframes(0u, last), 1e2);
    solve(INT64_MAX);
    CHECK(!slam.corrected && slam.keyframes.graph.loop_count == 1u);
    slam.keyframes.graph.loop_count = slam.record_count = 0u;
    const ek_pose before = between_keyframes(0u, last);
    close_by_hand(0u, last, ek_se2_compose(before, pose_of(0.2, 0.0, 0.0)), 1e4);
    solve(INT64_MAX);
    ek_pose moved = ek_se2_between(before, between_keyframes(0u, last));
    CHECK(slam.corrected && slam.keyframes.graph.loop_count == 1u);
    CHECK_NEAR(moved.x, 0.2, 0.002);
    CHECK_NEAR(moved.y, 0.0, 0.002);
    for (int axis = 0; axis < 2; axis++) {
        slam.keyframes.graph.loop_count = slam.record_count = 0u;
        solve(INT64_MAX);
        const ek_pose there = between_keyframes(0u, last), far = axis ? pose_of(0.0, 3e5, 0.0) : pose_of(3e5, 0.0, 0.0);
        close_by_hand(1u, last - 1u, far, 1e-8);
        solve(INT64_MAX);
        moved = ek_se2_between(there, between_keyframes(0u, last));
        CHECK(slam.keyframes.graph.loop_count == 0u && slam.record[0].withdrawn && !slam.record[0].accepted);
        CHECK_NEAR(moved.x, 0.0, TOLERANCE);
        CHECK_NEAR(moved.y, 0.0, TOLERANCE);
    }
    free(arena.memory);
}

/* The correction of a scan between two keyframes: none of it at the first, all of it at the second and beyond. */
static void corrections_are_distributed_between_keyframes(void)
{
    const ek_slam_parameters p = parameters_of(0);
    ek_arena arena = start(&p);
    uint64_t seed = 7u;
    const ek_pose lone = ek_slam_correct(&slam, 0u, pose_of(1.0, 2.0, 0.0)); /* no keyframe yet */
    CHECK_NEAR(lone.x, 1.0, TOLERANCE);
    CHECK_NEAR(lone.y, 2.0, TOLERANCE);
    for (size_t k = 0; k < 30u; k++) {
        step_without_odometry(k, k, &seed);
    }
    ek_pose *const pose = slam.keyframes.graph.pose, *const odom = slam.odom_from_keyframe;
    odom[3] = pose[3] = pose_of(1.0, 0.0, 0.0);
    odom[4] = pose_of(2.0, 0.0, 0.0);
    pose[4] = pose_of(2.0, 0.4, 0.0); /* moved by 0.4 m to the left */
    static const double driven[] = {0.0, 0.25, 0.5, 1.0, 1.5}, expected[] = {0.0, 0.1, 0.2, 0.4, 0.4};
    for (size_t k = 0; k < 5u; k++) {
        const ek_pose found = ek_slam_correct(&slam, 3u, pose_of(1.0 + driven[k], 0.0, 0.0));
        CHECK_NEAR(found.x, 1.0 + driven[k], TOLERANCE);
        CHECK_NEAR(found.y, expected[k], TOLERANCE);
    }
    odom[4] = odom[3]; /* at one place: all of it at once */
    const ek_pose same = ek_slam_correct(&slam, 3u, pose_of(1.01, 0.0, 0.0));
    CHECK_NEAR(same.x, 2.01, 1e-5);
    CHECK_NEAR(same.y, 0.4, 1e-5);
    free(arena.memory);
}

/* A robot that stands on an axis and turns: half of the way between two keyframes, half of a missing turn. */
static void a_missing_turn_is_distributed_too(void)
{
    const ek_slam_parameters p = parameters_of(0);
    ek_arena arena = start(&p);
    uint64_t seed = 7u;
    for (size_t k = 0; k < 30u; k++) {
        step_without_odometry(k, k, &seed);
    }
    ek_pose *const pose = slam.keyframes.graph.pose, *const odom = slam.odom_from_keyframe;
    odom[3] = pose[3] = pose_of(0.0, 0.0, 0.0);
    odom[4] = pose_of(1.0, 0.0, 0.0);
    pose[4] = pose_of(1.1, 0.2, -0.4);
    static const double driven[] = {0.0, 0.25, 0.5, 1.0, 2.0}, shares[] = {0.0, 0.25, 0.5, 1.0, 1.0};
    for (size_t k = 0; k < 5u; k++) {
        const ek_pose found = ek_slam_correct(&slam, 3u, pose_of(driven[k], 0.0, 0.0));
        CHECK_NEAR(found.x, driven[k] + 0.1 * shares[k], TOLERANCE);
        CHECK_NEAR(found.y, 0.2 * shares[k], TOLERANCE);
        CHECK_NEAR(found.theta, -0.4 * shares[k], TOLERANCE);
    }
    odom[4] = pose_of(0.0, 0.0, 0.8); /* a turn on the spot of 0.8, which was one of 1.0 */
    pose[4] = pose_of(0.0, 0.0, 1.0);
    CHECK_NEAR(ek_slam_correct(&slam, 3u, pose_of(0.0, 0.0, 0.2)).theta, 0.25, TOLERANCE);
    free(arena.memory);
}

/* Invert a symmetric positive definite 3 x 3 matrix, in the order xx, xy, xt, yy, yt, tt, by its cofactors. */
static void invert(const double a[6], double inverse[6])
{
    inverse[0] = a[3] * a[5] - a[4] * a[4];
    inverse[1] = a[2] * a[4] - a[1] * a[5];
    inverse[2] = a[1] * a[4] - a[2] * a[3];
    inverse[3] = a[0] * a[5] - a[2] * a[2];
    inverse[4] = a[1] * a[2] - a[0] * a[4];
    inverse[5] = a[0] * a[3] - a[1] * a[1];
    const double determinant = a[0] * inverse[0] + a[1] * inverse[1] + a[2] * inverse[2];
    for (size_t k = 0; k < 6u; k++) {
        inverse[k] /= determinant;
    }
}

/* Two walls at right angles, of 80 and of `upright` points 5 cm apart, away from their corner, seen turned by 0.3 rad,
 * with ten points that lie on no wall. A point on a wall with the normal (u, v) in the scan's frame weighs
 * (u, v, x v - y u). */
static void a_match_has_the_covariance_of_a_plain_computation(size_t upright)
{
    const ek_slam_parameters p = parameters_of(0);
    ek_arena arena = start(&p);
    ek_loop_finder *const finder = &slam.finder;
    const ek_pose match = pose_of(2.0, 1.5, 0.3), predicted = pose_of(2.05, 1.42, 0.28);
    const ek_sym3 spread = {EK_R(0.01), EK_R(0.002), EK_R(0.0), EK_R(0.02), EK_R(0.0), EK_R(0.003)};
    const double spread_of[] = {0.01, 0.002, 0.0, 0.02, 0.0, 0.003}, error = 0.02;
    const size_t on_walls = 80u + upright, count = on_walls + 10u;
    double sum[6] = {1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-2}, covariance[6], inverse[6];
    for (size_t k = 0; k < count; k++) {
        const int level = k < 80u, off = k >= on_walls;
        const ek_pose at = pose_of(level ? 1.0 + 0.05 * (double)k : off ? 3.0 + 0.1 * (double)k : 0.0,
                                   level ? 0.0 : off ? 9.0 : 1.0 + 0.05 * (double)(k - 80u), 0.0);
        const ek_pose seen = ek_se2_between(match, at);
        finder->target[2u * k] = at.x;
        finder->target[2u * k + 1u] = at.y;
        finder->source[2u * k] = seen.x;
        finder->source[2u * k + 1u] = seen.y;
        if (!off) {
            const double u = level ? sin(0.3) : cos(0.3), v = level ? cos(0.3) : -sin(0.3);
            const double row[] = {u, v, (double)seen.x * v - (double)seen.y * u}, weight = 1.0 / (10.0 * error * error);
            for (size_t i = 0, at_row = 0; i < 3u; i++) {
                for (size_t j = i; j < 3u; j++, at_row++) {
                    sum[at_row] += weight * row[i] * row[j];
                }
            }
        }
    }
    CHECK(ek_index_build(&finder->index, finder->target, on_walls) == EK_OK);
    CHECK(ek_normals_compute(&finder->index, 8u, EK_R(1.0), finder->normals) == EK_OK);
    finder->index.normals = finder->normals;
    finder->source_count = count;
    finder->match = match;
    finder->motion = predicted;
    finder->covariance = spread;
    finder->match_error = EK_R(error);
    finder->phase = EK_FINDER_JUDGE;
    finder->settings.gate = finder->settings.degenerate = EK_R(1e6);
    finder->settings.overlap = EK_R(0.0);
    ek_work work = ek_work_make(INT64_MAX);
    ek_loop_judge(finder, &work);
    const ek_loop_candidate *const found = &finder->candidate;
    CHECK(found->outcome == EK_LOOP_PASSED && finder->phase == EK_FINDER_IDLE);
    CHECK(work.done > 100u * on_walls && work.done <= 200u * count);
    CHECK_NEAR(found->number[1], (double)on_walls / (double)count, 1e-6);

    invert(sum, covariance);
    covariance[0] += 0.015 * 0.015;
    covariance[3] += 0.015 * 0.015;
    covariance[5] += 0.004 * 0.004;
    ek_observer_take(&finder->observer, &finder->thinner, finder->source, on_walls, &work);
    const ek_openness open = ek_observer_measure(&finder->observer, EK_R(2.0) * EK_MAX_COORDINATE);
    const double x = (double)open.x, y = (double)open.y, share = 1.0 - (double)open.ratio / 0.3;
    CHECK((share > 0.0) == (upright < 20u));
    const double variance = share > 0.0 ? 0.15 * share * 0.15 * share : 0.0;
    covariance[0] += variance * x * x;
    covariance[1] += variance * x * y;
    covariance[3] += variance * y * y;
    invert(covariance, inverse);
    const ek_sym3 *const information = &found->edge.information;
    const ek_real entries[] = {information->xx, information->xy, information->xt,
                               information->yy, information->yt, information->tt};
    const double scale = sizeof(ek_real) == sizeof(float) ? 2e-3 : 1e-9;
    for (size_t k = 0; k < 6u; k++) {
        CHECK_NEAR(entries[k], inverse[k], scale * (fabs(inverse[0]) + fabs(inverse[3]) + fabs(inverse[5])));
    }
    const ek_pose gap = ek_se2_between(match, predicted);
    const double g[] = {(double)gap.x, (double)gap.y, (double)gap.theta};
    for (size_t k = 0; k < 6u; k++) {
        covariance[k] += spread_of[k];
    }
    invert(covariance, inverse);
    const double chi = inverse[0] * g[0] * g[0] + inverse[3] * g[1] * g[1] + inverse[5] * g[2] * g[2] +
                       2.0 * (inverse[1] * g[0] * g[1] + inverse[2] * g[0] * g[2] + inverse[4] * g[1] * g[2]);
    CHECK_NEAR(found->chi, chi, scale * (1.0 + chi));
    CHECK_NEAR(found->number[0], chi, scale * (1.0 + chi));
    free(arena.memory);
}

/* Wheels that measure 5 % too much: 1 m at scale 1 is assumed before, and the scale remembers 50 m. */
static void the_scale_of_the_wheels_is_learned(void)
{
    const ek_openness closed = {.x = EK_R(1.0), .ratio = EK_R(1.0)}, open = {.x = EK_R(1.0)};
    const ek_slam_parameters p = parameters_of(0);
    ek_arena arena = start(&p);
    ek_wheels *const wheels = &slam.wheels;
    double matched = 1.0, driven = 1.0;
    wheels->has_last = 1;
    ek_slam_observe_wheels(&slam, pose_of(0.0, 0.0, 0.0), &closed, 1); /* the first keyframe */
    for (int k = 1; k <= 60; k++) {
        wheels->now = pose_of(1.05 * k, 0.0, 0.0);
        ek_slam_observe_wheels(&slam, pose_of(1.0, 0.0, 0.0), &closed, 1);
        matched += 1.0;
        driven += 1.05;
        if (driven > 50.0) {
            matched *= 50.0 / driven;
            driven = 50.0;
        }
        CHECK_NEAR(wheels->matched, matched, 1e-3);
        CHECK_NEAR(wheels->driven, driven, 1e-3);
    }
    const ek_wheels before = *wheels;
    static const double steps[][2] = {{1.05, 1.3}, {1.05, 0.7}, {0.5, 0.62}, {0.5, 0.38}, {0.05, 0.05}, {0.0, 0.0}}; /* wheels, match */
    for (size_t k = 0; k < 6u; k++) { /* slipping, blocked, hardly moving and standing wheels do not count */
        wheels->keyframe = wheels->now;
        wheels->now.x += EK_R(steps[k][0]);
        ek_slam_observe_wheels(&slam, pose_of(steps[k][1], 0.0, 0.0), &closed, 1);
        CHECK_NEAR(wheels->driven, before.driven, 0.0);
    }
    wheels->now.x += EK_R(1.05); /* nor does a step after a lost track, in a corridor, out of one, or without odometry */
    ek_slam_observe_wheels(&slam, pose_of(1.0, 0.0, 0.0), &closed, 0);
    wheels->now.x += EK_R(1.05);
    ek_slam_observe_wheels(&slam, pose_of(1.0, 0.0, 0.0), &open, 1);
    wheels->now.x += EK_R(1.05);
    ek_slam_observe_wheels(&slam, pose_of(1.0, 0.0, 0.0), &closed, 1);
    wheels->has_last = 0;
    wheels->now.x += EK_R(1.05);
    ek_slam_observe_wheels(&slam, pose_of(1.0, 0.0, 0.0), &closed, 1);
    wheels->has_last = 1;
    wheels->now.x += EK_R(1.05);
    ek_slam_observe_wheels(&slam, pose_of(1.0, 0.0, 0.0), &closed, 1);
    CHECK_NEAR(wheels->matched, before.matched, 0.0);

    uint64_t seed = 3u; /* the next sweep's odometry is scaled from where it is known */
    ek_sweep sweep = sweep_at(0u, &seed);
    sweep.odom_from_base = pose_of(10.0, 0.0, 0.0);
    sweep.start_from_end = pose_of(1.05, 0.0, 0.0);
    wheels->has_last = 0;
    wheels->matched = EK_R(40.0);
    wheels->driven = EK_R(50.0);
    ek_noted next;
    ek_sweep prepared = ek_slam_prepare(&slam, &sweep, &next);
    CHECK_NEAR(prepared.odom_from_base.x, 10.0, TOLERANCE);
    CHECK_NEAR(prepared.start_from_end.x, 0.84, TOLERANCE);
    CHECK(prepared.ranges == slam.cleaned);
    for (size_t i = 0; i < sweep.beams; i++) {
        CHECK_NEAR(prepared.ranges[i], sweep.ranges[i], 0.0);
    }
    slam.wheels = next.wheels;
    sweep.odom_from_base.x = EK_R(12.0);
    prepared = ek_slam_prepare(&slam, &sweep, &next);
    CHECK_NEAR(prepared.odom_from_base.x, 11.6, TOLERANCE);
    for (size_t i = 0; i < BEAMS; i += 10u) { /* a dirty scan is cleaned */
        ranges[i] = EK_R(4.0) + ranges[i];
    }
    for (uint32_t k = 0; k < 40u; k++) { /* once the lidar is known to be dirty */
        const ek_real range = ek_slam_prepare(&slam, &sweep, &next).ranges[40];
        CHECK(isnan(range) == (next.dirt.share >= EK_R(0.015)) && next.dirt.scans == 51u + k);
        slam.dirt = next.dirt;
    }
    CHECK(next.dirt.share >= EK_R(0.015));
    for (size_t i = 0; i < BEAMS; i++) { /* fine beams that tremble by 10 cm are smoothed */
        ranges[i] = i % 2u ? EK_R(1.1) : EK_R(1.0);
        angles[i] = EK_R(0.25 / 180.0) * EK_PI * (ek_real)i;
    }
    prepared = ek_slam_prepare(&slam, &sweep, &next);
    CHECK(prepared.ranges == slam.cleaned);
    CHECK_NEAR(prepared.ranges[10], 1.0, TOLERANCE);
    sweep.beams = BEAMS + 1u; /* refused later, not smoothed beyond the memory */
    CHECK(ek_slam_prepare(&slam, &sweep, &next).ranges == sweep.ranges);
    sweep.angles = NULL;
    CHECK(ek_slam_prepare(&slam, &sweep, &next).angles == NULL);
    sweep.ranges = NULL;
    CHECK(ek_slam_prepare(&slam, &sweep, &next).ranges == NULL);
    free(arena.memory);
}

/* A guess turned by 24 degrees, from which the first match has few pairs: a further try from another heading finds the
 * pose, but only for the first poor match of a scan. */
static void a_turned_guess_is_found_by_a_further_try(void)
{
    ek_slam_parameters p = parameters_of(0);
    ek_arena arena = start(&p);
    uint64_t seed = 7u;
    ek_match match;
    for (size_t k = 0; k < 20u; k++) {
        step_without_odometry(k, k, &seed);
    }
    slam.parameters.matcher.max_correspondence = EK_R(0.01); /* of the first match only */
    const ek_pose truth = slam.motion.start_from_base;
    static const double turns_deg[] = {24.0, -24.0};
    for (size_t k = 0; k < 2u; k++) {
        const ek_pose guess = ek_se2_compose(truth, pose_of(0.05, 0.0, turns_deg[k] * (double)EK_PI / 180.0));
        slam.tried = 0;
        CHECK(ek_slam_match(&slam, &slam.map_index, guess, NULL, 0, &match) == EK_OK && slam.tried);
        const ek_pose found = ek_se2_between(truth, match.target_from_source);
        CHECK_NEAR(found.x, 0.0, 0.03);
        CHECK_NEAR(found.y, 0.0, 0.03);
        CHECK_NEAR(found.theta, 0.0, 0.02);
        CHECK(ek_slam_match(&slam, &slam.map_index, guess, NULL, 0, &match) == EK_OK);
        CHECK(EK_FABS(ek_se2_between(truth, match.target_from_source).theta) > EK_R(0.1));
    }
    slam.parameters.matcher = p.matcher;
    for (int unusual = 0; unusual < 2; unusual++) { /* a good match is tried again where it is worse than most were */
        slam.usual_error = EK_R(unusual ? 1e-4 : 0.0);
        slam.tried = 0;
        CHECK(ek_slam_match(&slam, &slam.map_index, truth, NULL, 0, &match) == EK_OK && slam.tried == unusual);
    }
    CHECK(ek_slam_match(&slam, &slam.map_index, pose_of(2e6, 0.0, 0.0), NULL, 0, &match) == EK_OUT_OF_RANGE);
    free(arena.memory);
}

/* Of a scan of 400 points or more a part is matched first, of 200 to 399 points, and then all of it. */
static void a_large_scan_is_matched_whole_after_a_part_of_it(void)
{
    ek_slam_parameters p = parameters_of(0);
    p.points = 2u * BEAMS;
    ek_arena arena = start(&p);
    uint64_t seed = 7u;
    ek_match match;
    for (size_t k = 0; k < 20u; k++) {
        step_without_odometry(k, k, &seed);
    }
    const size_t once = slam.scan.count;
    memcpy(slam.scan.hits + 2u * once, slam.scan.hits, 2u * once * sizeof(ek_real)); /* each point twice */
    slam.scan.count = 2u * once;
    CHECK(once >= 300u);
    const ek_pose truth = slam.motion.start_from_base;
    const ek_pose guess = ek_se2_compose(truth, pose_of(0.05, -0.03, 0.02));
    CHECK(ek_slam_match(&slam, &slam.map_index, guess, NULL, 0, &match) == EK_OK && match.inliers > 250);
    const ek_pose found = ek_se2_between(truth, match.target_from_source);
    CHECK_NEAR(found.x, 0.0, 0.01);
    CHECK_NEAR(found.y, 0.0, 0.01);
    CHECK_NEAR(found.theta, 0.0, 0.005);
    const uint64_t matched_whole = slam.matching;
    slam.matching = 0u;
    CHECK(ek_slam_match(&slam, &slam.map_index, guess, NULL, 1, &match) == EK_OK);
    CHECK(slam.matching < matched_whole && (size_t)match.inliers > 2u * once * 9u / 10u); /* those of the part, times two */
    const int32_t of_part = slam.parameters.min_inliers;
    slam.parameters.min_inliers = 1000; /* too few of the part: not counted as more */
    CHECK(ek_slam_match(&slam, &slam.map_index, guess, NULL, 1, &match) == EK_OK && (size_t)match.inliers <= once);
    slam.parameters.min_inliers = of_part;
    free(arena.memory);
}

/* A sweep that leads out of the world is refused, by odometry, by its sensor's place or by its points; one without
 * points gets the predicted pose. */
static void sweeps_beyond_the_world_are_refused(void)
{
    static const ek_real huge = sizeof(ek_real) == sizeof(float) ? EK_R(3e38) : EK_R(1.5e308);
    ek_slam_parameters p = parameters_of(0);
    ek_arena arena = start(&p);
    ek_slam_estimate estimate;
    uint64_t seed = 7u;
    ek_sweep sweep = sweep_at(0u, &seed);
    sweep.odom_from_base = pose_of(-1e6, 0.0, 0.0);
    CHECK(ek_slam_update(&slam, &sweep, &estimate) == EK_OK);
    const ek_pose far[] = {pose_of(1.1e6, 0.0, 0.0), pose_of(0.0, -1.1e6, 0.0), pose_of(-1e6 + 3e5, 0.0, 0.0),
                           pose_of(-1e6, 3e5, 0.0), pose_of(1e6, 0.0, 0.0)};
    for (size_t k = 0; k < sizeof far / sizeof *far; k++) {
        sweep = sweep_at(1u, &seed);
        sweep.odom_from_base = far[k];
        CHECK(ek_slam_update(&slam, &sweep, &estimate) == EK_OUT_OF_RANGE);
        CHECK(slam.map_changed); /* no part of the map was taken there */
    }
    sweep = sweep_at(1u, &seed);
    sweep.odom_from_base = pose_of(-1e6 + 0.5, 0.0, 0.0);
    for (size_t i = 0; i < BEAMS; i++) {
        ranges[i] = (ek_real)INFINITY;
    }
    CHECK(ek_slam_update(&slam, &sweep, &estimate) == EK_OK && !estimate.scan_to_map_accepted);
    CHECK_NEAR(estimate.odom_from_base.x, 0.5, 1e-6 * (sizeof(ek_real) == sizeof(float) ? 1e5 : 1.0));
    sweep.stamp_ns += STEP_NS;
    sweep.odom_from_base = pose_of(-1e6, 0.0, 0.0);
    sweep.odom_from_base.theta = huge;
    CHECK(ek_slam_update(&slam, &sweep, &estimate) == EK_OK);
    sweep.stamp_ns += STEP_NS;
    sweep.odom_from_base.theta = -huge; /* their difference is no number */
    CHECK(ek_slam_update(&slam, &sweep, &estimate) == EK_OUT_OF_RANGE);
    for (int axis = 0; axis < 2; axis++) {
        (axis ? &slam.parameters.scan.base_from_sensor.y : &slam.parameters.scan.base_from_sensor.x)[0] = EK_R(1001.0);
        sweep = sweep_at(9u, &seed);
        sweep.has_odometry = 0;
        CHECK(ek_slam_update(&slam, &sweep, &estimate) == EK_OUT_OF_RANGE);
        slam.parameters.scan.base_from_sensor = pose_of(0.0, 0.0, 0.0);
    }
    CHECK(ek_slam_update(&slam, &sweep, NULL) == EK_NULL_POINTER);
    free(arena.memory);
    p.use_odometry = 0; /* then what it says does not matter */
    arena = start(&p);
    for (size_t k = 0; k < 20u; k++) {
        sweep = sweep_at(k, &seed);
        sweep.odom_from_base = pose_of(0.0, 0.0, 0.0);
        CHECK(ek_slam_update(&slam, &sweep, &estimate) == EK_OK && !estimate.lost);
        check_near_truth(k, estimate.start_from_base, 0.05);
    }
    free(arena.memory);
}

static void memory_and_parameters_are_checked(void)
{
    ek_slam_parameters p = ek_slam_default();
    size_t bytes = 1u;
    CHECK(ek_slam_bytes(&p, &bytes) == EK_OK && bytes > 1000000u);
    p.keyframe_points = SIZE_MAX / 8u;
    CHECK(ek_slam_bytes(&p, &bytes) == EK_OUT_OF_RANGE && bytes == 0u);
    p = ek_slam_default();
    p.loop.radius = EK_R(13.0); /* more than EK_SEARCH_MAX_HALF cells */
    CHECK(ek_slam_bytes(&p, &bytes) == EK_OUT_OF_RANGE);
    p = ek_slam_default();
    p.matcher.metric = EK_METRIC_POINT;
    CHECK(ek_slam_bytes(&p, &bytes) == EK_OUT_OF_RANGE);
    p = ek_slam_default();
    p.map_reach = (ek_real)NAN;
    CHECK(ek_slam_bytes(&p, &bytes) == EK_NOT_FINITE);
    CHECK(ek_slam_bytes(NULL, &bytes) == EK_NULL_POINTER);
}

int main(void)
{
    memory_and_parameters_are_checked();
    refused_scans_change_nothing();
    a_carried_robot_finds_its_place();
    a_covered_lidar_keeps_its_track_for_a_while();
    the_unevenness_of_a_turn_is_that_of_a_hand_calculation();
    a_scan_within_which_the_robot_turns_unevenly_is_set_aside(61u, 0.0);
    a_scan_within_which_the_robot_turns_unevenly_is_set_aside(66u, 0.03);
    a_step_is_doubted_where_its_matches_fit_poorly();
    a_step_is_doubted_where_its_matches_are_far_from_the_odometry();
    a_match_far_from_the_odometry_must_be_clear();
    a_match_is_accepted_up_to_twenty_times_its_usual_distance_or_a_quarter_of_the_step();
    a_doubted_match_stays_where_odometry_and_the_match_before_agree();
    a_match_that_fits_poorly_must_be_nearer_to_the_odometry();
    the_gate_accepts_no_match_of_few_points_against_good_odometry();
    a_lost_robot_is_looked_for_at_all_places_in_turn();
    after_a_step_of_the_wheels_alone_five_turns_look_at_four_kinds_of_places();
    each_bound_refuses_candidates_with_its_own_outcome();
    slices_change_no_bit_of_a_candidate();
    a_search_in_small_slices_is_dropped_by_a_lost_track();
    a_loop_waits_for_another_that_agrees();
    memory_that_is_used_up_costs_only_what_it_was_for();
    false_loops_are_withdrawn(INT64_MAX);
    false_loops_are_withdrawn(1000);
    a_certain_loop_corrects_and_an_impossible_one_is_taken_away();
    corrections_are_distributed_between_keyframes();
    a_missing_turn_is_distributed_too();
    a_match_has_the_covariance_of_a_plain_computation(60u);
    a_match_has_the_covariance_of_a_plain_computation(12u); /* nearly a corridor */
    the_scale_of_the_wheels_is_learned();
    a_turned_guess_is_found_by_a_further_try();
    a_large_scan_is_matched_whole_after_a_part_of_it();
    sweeps_beyond_the_world_are_refused();
    drive(0, 0.03);
    work_is_in_proportion_to_the_time_between_scans();
    a_scan_that_is_hard_to_match_leaves_no_work_for_the_search();
    const uint64_t most = drive(100000, 0.03); /* every 0.2 s: twice the work */
    CHECK(most < 200000u + 160u * 4000u); /* the largest part: the normals of a target of less than 4,000 points */
    free(lasting.memory);
    return verdict();
}

/* The SLAM on a drive around a ring of corridors: loops, slices, memory, refused scans. */
#include "check.h"
#include "ek/slam.h"

#define BEAMS 360u
#define STEP_NS 200000000
#define LAP 150u /* scans */
#define SCANS 190u

static ek_slam slam;
static ek_real ranges[BEAMS], angles[BEAMS];

/* Walls of two rectangles, one in the other, and of boxes in the corridors: x0, y0, x1, y1. */
static const double BOXES[][4] = {{0, 0, 9, 7}, {2, 2, 7, 5}, {3, 0, 3.6, 0.4}, {8.6, 3, 9, 3.9}, {5, 6.6, 5.4, 7}, {0, 2.6, 0.5, 3.1}};

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
    memset(arena.memory, 0xA5, bytes); /* the code must not rely on zeros */
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
    drive(0, 0.03);
    const uint64_t most = drive(100000, 0.03);
    CHECK(most < 100000u + 160u * 4000u); /* the largest part: the normals of a target of less than 4,000 points */
    return verdict();
}

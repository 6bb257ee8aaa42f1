/* The SLAM of count.c: its two configurations in BOARD.md, recordings, and random drives through a room. */
#include "count.h"
#include "small_slam.h"

#include <stdio.h>
#include <string.h>

#define DRIVE 100 /* scans */
#define FEW_BEAMS 96u
#define MANY_BEAMS 640u /* of one drive in sixteen: large scans are matched in parts first */

ek_slam slam;

int is_slam(const char *name)
{
    return strcmp(name, "slam") == 0 || strcmp(name, "slam-default") == 0;
}

ek_slam_parameters slam_parameters(const char *name)
{
    return strcmp(name, "slam") == 0 ? small_slam(360u, 300u) : ek_slam_default();
}

static int begin_slam(const ek_slam_parameters *parameters)
{
    size_t bytes;
    ek_status status = ek_slam_bytes(parameters, &bytes);
    if (status == EK_OK) {
        status = take_memory(bytes) ? ek_slam_start(&slam, aligned, bytes, parameters) : EK_TOO_LITTLE_MEMORY;
    }
    return status == EK_OK ? 0 : fail("start", status);
}

ek_status call_slam(void *sweep)
{
    static ek_slam_estimate estimate;
    return ek_slam_update(&slam, (const ek_sweep *)sweep, &estimate);
}

/* Sizes; the bounds are those of a lost robot whose scans are not more than 0.1 s apart. */
int print_slam(const char *name)
{
    const ek_slam_parameters parameters = slam_parameters(name);
    size_t bytes;
    const ek_status status = ek_slam_bytes(&parameters, &bytes);
    if (status != EK_OK) {
        return fail(name, status);
    }
    printf("%lu %lu", (unsigned long)sizeof slam, (unsigned long)bytes);
#ifdef EK_TALLY
    if (begin_slam(&parameters)) {
        return 1;
    }
    slam.finder.apart = 1;
    print_bound(bound_slam);
#endif
    putchar('\n');
    return 0;
}

static int begin_configured(const char *name, const ek_scan_parameters *scan)
{
    ek_slam_parameters parameters = slam_parameters(name);
    parameters.scan = *scan;
    return begin_slam(&parameters);
}

static int count_one(const ek_sweep *sweep, int silent)
{
    return count_scan(call_slam, sweep, bound_slam, silent);
}

int log_slam(const char *name, const char *path)
{
    return run_log(begin_configured, count_one, name, path);
}

/* Loops are looked for often, and many pass. */
static void draw_loops(ek_loop_settings *loop)
{
    loop->path = EK_R(uniform(0.3, 3.0));
    loop->spacing = EK_R(uniform(0.0, 0.5));
    loop->radius = EK_R(uniform(0.5, 4.0));
    loop->submap = EK_R(uniform(0.3, 3.0));
    loop->cell = EK_R(uniform(0.05, 0.3));
    loop->score = EK_R(uniform(0.05, 0.6));
    loop->ambiguity = EK_R(uniform(0.8, 1.0));
    loop->overlap = EK_R(uniform(0.2, 0.8));
    loop->in_view = EK_R(uniform(0.5, 1.0));
    loop->degenerate = EK_R(uniform(0.1, 3.0));
    loop->gate = EK_R(whole(0u, 1u) ? uniform(5.0, 20.0) : uniform(20.0, 5000.0)); /* a large one lets false loops pass */
    loop->quick_gate = EK_R(uniform(0.0, 1.0)) * loop->gate;
}

static ek_slam_parameters drawn_slam(void)
{
    ek_slam_parameters p = ek_slam_default();
    p.scan.range_max = EK_R(uniform(4.0, 12.0));
    p.scan.base_from_sensor.x = EK_R(uniform(-0.3, 0.3));
    p.matcher.max_iterations = (int32_t)whole(1u, 40u);
    p.matcher.epsilon = EK_R(whole(0u, 1u) ? 1e-6 : 0.0);
    p.matcher.max_correspondence = EK_R(uniform(0.2, 1.0));
    p.matcher.one_to_one = (int32_t)whole(0u, 1u);
    p.fine_correspondence = EK_R(uniform(0.1, 0.5));
    p.deskew = (int32_t)whole(0u, 1u);
    p.use_odometry = (int32_t)(whole(0u, 7u) > 0u);
    p.min_inliers = (int32_t)whole(2u, 10u);
    p.keyframe_distance = EK_R(whole(0u, 3u) ? uniform(0.1, 0.5) : 0.0);
    p.map_radius = EK_R(uniform(3.0, 30.0));
    p.map_reach = EK_R(uniform(2.0, 20.0));
    p.drift.sigma = EK_R(uniform(0.002, 0.05)); /* a small one: loops contradict each other */
    p.drift.sigma_theta = EK_R(uniform(0.001, 0.02));
    draw_loops(&p.loop);
    const uint32_t digits = whole(7u, 13u);
    p.work = (int64_t)whole(1u, 8u) << digits;
    p.points = whole(0u, 15u) ? whole(20u, FEW_BEAMS) : whole(FEW_BEAMS, MANY_BEAMS);
    p.keyframes = whole(2u, 60u);
    p.keyframe_points = p.keyframes * whole(1u, (uint32_t)p.points);
    p.loops = whole(1u, 10u);
    p.records = whole(1u, 60u);
    p.voxels = whole(20u, 1500u);
    p.map_points = whole(20u, (uint32_t)p.voxels);
    p.loop_points = whole(60u, 1500u);
    p.score_cells = (size_t)128u * whole(128u, 200u);
    return p;
}

/* Where a robot is, and where its wheels say that it is. */
typedef struct {
    double around, x, y, heading; /* rad, m, m, rad */
    ek_pose wheels;
    double slip, noise; /* share of a step, rad */
    int has_wheels;
} robot;

static double along_circle(robot *at, double step)
{
    at->around += step;
    at->x = 1.6 * (double)EK_COS(EK_R(at->around));
    at->y = 1.1 * (double)EK_SIN(EK_R(at->around));
    const double before = at->heading;
    at->heading = at->around + 0.5 * (double)EK_PI;
    return at->heading - before;
}

/* Drive on, or, now and then, be carried away: the wheels do not turn then. */
static void drive_on(robot *at)
{
    const int carried = whole(0u, 149u) == 0u;
    const double turn = along_circle(at, carried ? uniform(0.5, 5.0) : uniform(0.0, 0.25));
    if (!carried) {
        const ek_pose step = {EK_R(1.35 * turn * (1.0 + at->slip)), EK_R(0.0), EK_R(turn + uniform(-at->noise, at->noise))};
        at->wheels = ek_se2_compose(at->wheels, step);
    }
    if (whole(0u, 199u) == 0u) { /* somebody turns the wheels */
        at->wheels.x += EK_R(uniform(-1.0, 1.0));
    }
}

/* Draw the scan of a robot in the room; some beams hit nothing. */
static void draw_room(const robot *at, size_t beams, double misses)
{
    for (size_t k = 0; k < beams; k++) {
        const double angle = 2.0 * (double)EK_PI * (double)k / (double)beams - (double)EK_PI;
        const double c = (double)EK_COS(EK_R(angle + at->heading)), s = (double)EK_SIN(EK_R(angle + at->heading));
        const double range = range_in_room(at->x, at->y, c, s) + uniform(-0.03, 0.03);
        ranges[k] = EK_R(uniform(0.0, 1.0) < misses ? (double)INFINITY : range);
        angles[k] = EK_R(angle);
    }
}

static ek_sweep sweep_of(const robot *at, size_t beams, int64_t *stamp_ns)
{
    ek_sweep sweep;
    memset(&sweep, 0, sizeof sweep);
    *stamp_ns += whole(0u, 19u) ? 100000000 : (int64_t)whole(1u, 30u) * 100000000;
    sweep.stamp_ns = *stamp_ns;
    sweep.beams = beams;
    sweep.time_increment_ns = whole(0u, 1u) ? 0 : 50000;
    sweep.ranges = ranges;
    sweep.angles = angles;
    sweep.has_odometry = at->has_wheels && whole(0u, 39u);
    sweep.odom_from_base = at->wheels;
    sweep.has_motion = sweep.has_odometry && whole(0u, 3u) == 0u;
    sweep.start_from_end.theta = EK_R(uniform(-0.05, 0.05));
    return sweep;
}

/* Make the newest loop false, now and then, while it is taken into the graph: the others contradict it. */
static void falsify(void)
{
    const ek_pose_graph *const graph = &slam.keyframes.graph;
    if (slam.task == EK_TASK_SOLVE && graph->loop_count > 0u && whole(0u, 3u) == 0u) {
        graph->loop[graph->loop_count - 1u].first_from_second.x += EK_R(uniform(-3.0, 3.0));
    }
}

static int random_slam(int silent)
{
    const ek_slam_parameters parameters = drawn_slam();
    const scan_kind odd = (scan_kind)whole(0u, KINDS - 1u);
    const double misses = whole(0u, 3u) ? 0.0 : uniform(0.0, 0.9);
    const uint32_t often = whole(0u, 3u) ? DRIVE : whole(0u, 10u); /* every so many scans is of another kind; 0: each */
    robot at;
    memset(&at, 0, sizeof at);
    at.slip = uniform(-0.05, 0.05);
    at.noise = uniform(0.0, 0.02);
    at.has_wheels = whole(0u, 3u) > 0u;
    int64_t stamp_ns = 0;
    int failed = begin_slam(&parameters);
    for (int number = 0; number < DRIVE && !failed; number++) {
        const size_t beams = whole(0u, 7u) ? parameters.points : whole(1u, (uint32_t)parameters.points);
        drive_on(&at);
        falsify();
        if (whole(0u, often) == 0u) {
            draw_scan(odd, number, beams, (double)parameters.scan.range_max);
        } else {
            draw_room(&at, beams, misses);
        }
        const ek_sweep sweep = sweep_of(&at, beams, &stamp_ns);
        failed = count_one(&sweep, silent);
    }
    return failed;
}

int random_slams(long sessions, int silent)
{
    int failed = 0;
    for (long session = 0; session < sessions && !failed; session++) {
        failed = random_slam(silent);
    }
    if (silent && !failed) {
        printf("%ld\n", sessions * DRIVE);
    }
    return failed;
}

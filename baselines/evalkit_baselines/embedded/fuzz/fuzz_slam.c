/* Arbitrary scans: poses stay finite, loops connect keyframes in order, a slice ends, and a refused scan changes nothing: a
 * second SLAM without it gives the same. */
#include "ek/slam.h"
#include "input.h"

#define MAX_COUNT 48u
#define SCANS 24
#define LIMIT 2000

typedef struct {
    ek_slam slam;
    ek_arena arena;
} robot;

static ek_slam_parameters parameters_of(ek_input *input)
{
    ek_slam_parameters parameters = ek_slam_default();
    const uint8_t flags = take_byte(input);
    parameters.scan.base_from_sensor = take_pose(input);
    parameters.scan.range_max = EK_R(30.0);
    parameters.points = MAX_COUNT;
    parameters.keyframes = 2u + flags % 32u;
    parameters.keyframe_points = 16u + 8u * (size_t)take_byte(input);
    parameters.loops = 1u + take_byte(input) % 4u;
    parameters.records = 1u + take_byte(input) % 8u;
    parameters.voxels = parameters.map_points = 64u + 4u * (size_t)take_byte(input);
    parameters.loop_points = 256u;
    parameters.score_cells = (size_t)128 * 128;
    parameters.min_inliers = take_byte(input) % 12;
    parameters.keyframe_distance = take_real(input);
    parameters.loop.path = take_real(input);
    parameters.loop.spacing = EK_R(0.0);
    parameters.loop.radius = EK_R(1.0);
    parameters.loop.score = EK_R(0.01) * (ek_real)(take_byte(input) % 60u);
    parameters.loop.overlap = EK_R(0.2);
    parameters.loop.degenerate = EK_R(10.0);
    parameters.loop.gate = parameters.loop.quick_gate = take_real(input);
    parameters.deskew = flags >> 5 & 1;
    parameters.use_odometry = flags >> 6 & 1;
    parameters.work = flags >> 7 ? LIMIT : 0;
    return parameters;
}

static int start(robot *made, const ek_slam_parameters *parameters)
{
    ek_arena measured = ek_arena_make(NULL, 0u);
    if (ek_slam_bytes(parameters, &measured.used) != EK_OK) {
        return 0;
    }
    made->arena = memory_for(&measured);
    HOLDS(ek_slam_start(&made->slam, made->arena.memory, measured.used, parameters) == EK_OK);
    return 1;
}

/* A beam: mostly along the walls of a room of 4 m by 6 m, so that keyframes match and loops close. */
static ek_real range_of(ek_input *input, ek_real angle)
{
    const uint8_t kind = take_byte(input);
    if (kind >= 240u) {
        return take_real(input);
    }
    const ek_real across = EK_R(2.0) / (EK_FABS(EK_COS(angle)) + EK_R(1e-6));
    const ek_real along = EK_R(3.0) / (EK_FABS(EK_SIN(angle)) + EK_R(1e-6));
    return (across < along ? across : along) + EK_R(1e-4) * (ek_real)kind;
}

static void check_loops(const ek_slam *slam)
{
    const ek_pose_graph *const graph = &slam->keyframes.graph;
    HOLDS(graph->loop_count <= slam->parameters.loops && slam->record_count <= slam->parameters.records);
    for (size_t l = 0; l < graph->loop_count; l++) {
        HOLDS(graph->loop[l].first < graph->loop[l].second && graph->loop[l].second < graph->count);
        HOLDS(slam->record[slam->record_of_loop[l]].accepted);
    }
    for (size_t k = 0; k < graph->count; k++) {
        HOLDS(ek_se2_is_finite(graph->pose[k]));
    }
}

static void see(robot *first, robot *second, ek_input *input, int64_t *stamp_ns)
{
    ek_sweep sweep;
    ek_slam_estimate estimate, other;
    memset(&sweep, 0, sizeof sweep);
    const uint8_t flags = take_byte(input);
    *stamp_ns = flags % 16u ? (int64_t)((uint64_t)*stamp_ns + 100000000u) : take_whole(input);
    sweep.stamp_ns = *stamp_ns;
    sweep.time_increment_ns = flags >> 4 & 1u ? take_time(input) : 0;
    sweep.has_odometry = flags >> 5 & 1u;
    sweep.has_motion = flags >> 6 & 1u;
    sweep.odom_from_base = sweep.has_odometry ? take_pose(input) : sweep.odom_from_base;
    sweep.start_from_end = sweep.has_motion ? take_pose(input) : sweep.start_from_end;
    sweep.beams = flags >> 7 ? MAX_COUNT : take_byte(input) % (MAX_COUNT + 2u);
    static ek_real range[MAX_COUNT + 2u], angle[MAX_COUNT + 2u];
    for (size_t i = 0; i < sweep.beams; i++) {
        angle[i] = EK_R(0.13) * (ek_real)i;
        range[i] = range_of(input, angle[i]);
    }
    sweep.ranges = range;
    sweep.angles = angle;
    const ek_status status = ek_slam_update(&first->slam, &sweep, &estimate);
    if (status == EK_OK) {
        HOLDS(ek_slam_update(&second->slam, &sweep, &other) == EK_OK);
        HOLDS(ek_se2_is_finite(estimate.start_from_base) && same_pose(estimate.start_from_base, other.start_from_base));
        HOLDS(same_pose(estimate.odom_from_base, other.odom_from_base) && estimate.work == other.work);
        HOLDS(ek_se2_is_finite(ek_slam_correct(&first->slam, estimate.keyframe, estimate.odom_from_base)));
        HOLDS(!first->slam.parameters.work || estimate.work < LIMIT + 200u * 16384u);
    }
    check_loops(&first->slam);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    static robot first, second;
    ek_input input = {bytes, size};
    int64_t stamp_ns = 0;
    const ek_slam_parameters parameters = parameters_of(&input);
    if (!start(&first, &parameters) || !start(&second, &parameters)) {
        return 0;
    }
    for (int scans = 0; scans < SCANS && input.left; scans++) {
        see(&first, &second, &input, &stamp_ns);
    }
    free(first.arena.memory);
    free(second.arena.memory);
    return 0;
}

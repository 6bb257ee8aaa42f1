/* Arbitrary scans: poses are finite; a refused scan changes nothing: a second pipeline without it gives the same. */
#include "ek/pipeline.h"
#include "input.h"

#define MAX_COUNT 24u

typedef struct {
    ek_pipeline pipeline;
    ek_arena arena;
} robot;

static ek_pipeline_parameters parameters_of(ek_input *input)
{
    ek_pipeline_parameters parameters = ek_pipeline_default();
    const uint8_t flags = take_byte(input);
    parameters.scan.base_from_sensor = take_pose(input);
    parameters.scan.range_max = EK_R(30.0);
    parameters.frontend.points = MAX_COUNT;
    parameters.frontend.keyframes = 1u + flags % 4u;
    parameters.frontend.min_inliers = take_byte(input) % 12;
    parameters.frontend.keyframe_distance = take_real(input);
    parameters.frontend.cells = take_byte(input);
    parameters.frontend.use_scan_to_scan = flags >> 2 & 1;
    parameters.frontend.use_scan_to_map = flags >> 3 & 1;
    const uint8_t map = take_byte(input);
    parameters.frontend.map_voxel = map & 1u ? EK_R(0.1) : EK_R(0.0);
    parameters.frontend.map_radius = map & 2u ? EK_R(1.0) : EK_R(15.0);
    parameters.frontend.voxels = 1u + (map >> 2 & 31u) * 4u;
    parameters.frontend.scan_to_scan.metric = parameters.frontend.scan_to_map.metric =
        map >> 7 ? EK_METRIC_LINE : EK_METRIC_POINT;
    parameters.frontend.scan_to_scan.share_noise = parameters.frontend.scan_to_map.share_noise = map >> 6 & 1;
    parameters.deskew = flags >> 4 & 1;
    parameters.map = flags >> 5 & 1;
    parameters.clear_no_returns = flags >> 6 & 1;
    parameters.grid.rolling = flags >> 7;
    parameters.grid.resolution = EK_R(0.1);
    parameters.grid.range_max = EK_R(1.0);
    parameters.grid.columns = parameters.grid.rows = 96u;
    parameters.grid.left = parameters.grid.bottom = -64;
    return parameters;
}

static int start(robot *made, const ek_pipeline_parameters *parameters)
{
    ek_arena measured = ek_arena_make(NULL, 0u);
    if (ek_pipeline_bytes(parameters, &measured.used) != EK_OK) {
        return 0;
    }
    made->arena = memory_for(&measured);
    HOLDS(ek_pipeline_start(&made->pipeline, made->arena.memory, measured.used, parameters) == EK_OK);
    return 1;
}

/* Pass the sweep to both pipelines; to the second only if the first accepted it. */
static void see(robot *first, robot *second, ek_input *input, int64_t *stamp_ns)
{
    ek_sweep sweep;
    ek_estimate estimate, other;
    memset(&sweep, 0, sizeof sweep);
    const uint8_t flags = take_byte(input);
    *stamp_ns = flags % 16u ? (int64_t)((uint64_t)*stamp_ns + 100000000u) : take_whole(input);
    sweep.stamp_ns = *stamp_ns;
    sweep.time_increment_ns = flags >> 4 & 1u ? take_time(input) : 0;
    sweep.has_odometry = flags >> 5 & 1u;
    sweep.has_motion = flags >> 6 & 1u;
    sweep.odom_from_base = sweep.has_odometry ? take_pose(input) : sweep.odom_from_base;
    sweep.start_from_end = sweep.has_motion ? take_pose(input) : sweep.start_from_end;
    sweep.beams = take_byte(input) % (MAX_COUNT + 2u);
    ek_real *const ranges = take_reals(input, sweep.beams), *const angles = take_reals(input, sweep.beams);
    sweep.ranges = ranges;
    sweep.angles = angles;
    const ek_status status = ek_pipeline_update(&first->pipeline, &sweep, &estimate);
    /* a pose too far for the map is kept and not mapped */
    const int kept = status == EK_OK || first->pipeline.frontend.motion.stamp_ns != second->pipeline.frontend.motion.stamp_ns ||
                     first->pipeline.frontend.motion.started != second->pipeline.frontend.motion.started;
    HOLDS(status == EK_OK || !kept || (status == EK_OUT_OF_RANGE && first->pipeline.parameters.map));
    if (kept) {
        HOLDS(ek_pipeline_update(&second->pipeline, &sweep, &other) == status);
        HOLDS(ek_se2_is_finite(estimate.start_from_base) && same_pose(estimate.start_from_base, other.start_from_base));
        HOLDS(estimate.keyframe == other.keyframe && estimate.scan_to_map.inliers == other.scan_to_map.inliers);
        HOLDS(estimate.scan_to_scan_outcome == other.scan_to_scan_outcome);
        HOLDS(estimate.scan_to_map_outcome == other.scan_to_map_outcome);
    }
    free(ranges);
    free(angles);
}

static void compare_maps(const ek_grid *a, const ek_grid *b)
{
    HOLDS(a->left == b->left && a->bottom == b->bottom);
    HOLDS(memcmp(a->cells, b->cells, (size_t)a->parameters.columns * a->parameters.rows * sizeof *a->cells) == 0);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    static robot first, second;
    ek_input input = {bytes, size};
    int64_t stamp_ns = 0;
    const ek_pipeline_parameters parameters = parameters_of(&input);
    if (!start(&first, &parameters) || !start(&second, &parameters)) {
        return 0;
    }
    for (int scans = 0; scans < 16 && input.left; scans++) {
        see(&first, &second, &input, &stamp_ns);
    }
    if (parameters.map) {
        compare_maps(&first.pipeline.grid, &second.pipeline.grid);
    }
    free(first.arena.memory);
    free(second.arena.memory);
    return 0;
}

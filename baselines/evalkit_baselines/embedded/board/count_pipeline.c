/* The pipeline of count.c: its configurations in BOARD.md, recordings and random scans. */
#include "count.h"

#include <stdio.h>
#include <string.h>

#define RANDOM_BEAMS 96u

/* Beams, keyframes, cells of the local map's index (0: as many as points need), side of the map in cells (0: no map), and
 * voxels of a lasting map, with lines (0: points and keyframes). */
typedef struct {
    const char *name;
    uint32_t points, keyframes, cells, side;
    double resolution, range_max; /* m */
    uint32_t voxels;
    double radius; /* of the lasting map (m) */
    int32_t polygon;
} configuration;

static const configuration configurations[] = {
    {"default", 2048u, 10u, 0u, 1024u, 0.05, 12.0, 0u, 0.0, 0},
    {"1600", 1600u, 10u, 0u, 512u, 0.05, 12.0, 0u, 0.0, 0},
    {"1600-no-map", 1600u, 10u, 0u, 0u, 0.05, 12.0, 0u, 0.0, 0},
    {"360", 360u, 5u, 8192u, 256u, 0.1, 8.0, 0u, 0.0, 0},
    {"1600-lines", 1600u, 10u, 0u, 0u, 0.05, 12.0, 16384u, 15.0, 0},
    {"360-lines", 360u, 10u, 0u, 0u, 0.1, 8.0, 4096u, 8.0, 0},
    {"360-lines-polygon", 360u, 10u, 0u, 256u, 0.1, 8.0, 4096u, 8.0, 1},
};

ek_pipeline pipeline;

static const configuration *find(const char *name)
{
    for (size_t k = 0; k < sizeof configurations / sizeof *configurations; k++) {
        if (strcmp(configurations[k].name, name) == 0) {
            return &configurations[k];
        }
    }
    return NULL;
}

int is_pipeline(const char *name)
{
    return find(name) != NULL;
}

int begin_pipeline(const ek_pipeline_parameters *parameters)
{
    size_t bytes;
    ek_status status = ek_pipeline_bytes(parameters, &bytes);
    if (status == EK_OK) {
        status = take_memory(bytes) ? ek_pipeline_start(&pipeline, aligned, bytes, parameters) : EK_TOO_LITTLE_MEMORY;
    }
    return status == EK_OK ? 0 : fail("start", status);
}

ek_pipeline_parameters configured(const char *name)
{
    const configuration *const chosen = find(name);
    ek_pipeline_parameters parameters = ek_pipeline_default();
    if (chosen->voxels) {
        parameters.frontend = ek_frontend_lines();
        parameters.frontend.voxels = chosen->voxels;
        parameters.frontend.map_radius = EK_R(chosen->radius);
    }
    parameters.frontend.points = chosen->points;
    parameters.frontend.keyframes = chosen->keyframes;
    parameters.frontend.cells = chosen->cells;
    parameters.map = chosen->side > 0u;
    if (parameters.map) {
        parameters.grid.polygon = chosen->polygon;
        parameters.grid.columns = parameters.grid.rows = chosen->side;
        parameters.grid.left = parameters.grid.bottom = -(int32_t)(chosen->side / 2u);
        parameters.grid.resolution = EK_R(chosen->resolution);
        parameters.grid.range_max = EK_R(chosen->range_max);
    }
    return parameters;
}

ek_status call_pipeline(void *sweep)
{
    static ek_estimate estimate;
    return ek_pipeline_update(&pipeline, (const ek_sweep *)sweep, &estimate);
}

int print_pipeline(const char *name)
{
    size_t bytes;
    const ek_pipeline_parameters parameters = configured(name);
    const ek_status status = ek_pipeline_bytes(&parameters, &bytes);
    if (status != EK_OK || begin_pipeline(&parameters)) {
        return status == EK_OK ? 1 : fail(name, status);
    }
    printf("%lu %lu", (unsigned long)sizeof pipeline, (unsigned long)bytes);
    print_bound(bound_pipeline);
    putchar('\n');
    return 0;
}

static int begin_configured(const char *name, const ek_scan_parameters *scan)
{
    ek_pipeline_parameters parameters = configured(name);
    parameters.scan = *scan;
    return begin_pipeline(&parameters);
}

static int count_one(const ek_sweep *sweep, int silent)
{
    return count_scan(call_pipeline, sweep, bound_pipeline, silent);
}

int log_pipeline(const char *name, const char *path)
{
    return run_log(begin_configured, count_one, name, path);
}

/* Draw lines, a lasting map and polygons. */
static void draw_lines(ek_pipeline_parameters *parameters)
{
    ek_icp_parameters *const stages[2] = {&parameters->frontend.scan_to_scan, &parameters->frontend.scan_to_map};
    for (int k = 0; k < 2; k++) {
        stages[k]->metric = whole(0u, 7u) ? EK_METRIC_LINE : EK_METRIC_POINT;
        stages[k]->cauchy = EK_R(whole(0u, 1u) ? uniform(0.01, 0.5) : 0.0);
        stages[k]->share_noise = (int32_t)whole(0u, 1u);
    }
    parameters->frontend.neighbours = whole(2u, 16u);
    parameters->frontend.map_voxel = EK_R(whole(0u, 7u) ? uniform(0.01, 0.5) : 0.0);
    parameters->frontend.map_radius = EK_R(uniform(0.5, 15.0));
    parameters->frontend.voxels = whole(1u, 1000u);
    parameters->grid.polygon = (int32_t)whole(0u, 1u);
}

static ek_pipeline_parameters drawn_parameters(int lines)
{
    ek_pipeline_parameters parameters = ek_pipeline_default();
    ek_icp_parameters *const stages[2] = {&parameters.frontend.scan_to_scan, &parameters.frontend.scan_to_map};
    parameters.scan.range_max = EK_R(uniform(3.0, 12.0));
    parameters.scan.base_from_sensor.x = EK_R(uniform(-0.3, 0.3));
    parameters.frontend.points = whole(8u, RANDOM_BEAMS);
    parameters.frontend.keyframes = whole(1u, 4u);
    parameters.frontend.cells = whole(0u, 1u) ? whole(16u, 2048u) : 0u;
    parameters.frontend.keyframe_distance = EK_R(whole(0u, 1u) ? 0.0 : 0.3);
    parameters.frontend.min_inliers = (int32_t)whole(2u, 10u);
    for (int k = 0; k < 2; k++) {
        stages[k]->max_iterations = (int32_t)whole(1u, 40u);
        stages[k]->epsilon = EK_R(whole(0u, 1u) ? 0.0 : 1e-4);
        stages[k]->max_correspondence = EK_R(uniform(0.05, 1.0));
        stages[k]->one_to_one = (int32_t)whole(0u, 1u);
        stages[k]->min_pairs = (int32_t)whole(2u, 5u);
    }
    parameters.map = whole(0u, 3u) > 0u;
    parameters.clear_no_returns = (int32_t)whole(0u, 1u);
    parameters.grid.columns = parameters.grid.rows = 32u * whole(1u, 5u);
    parameters.grid.left = parameters.grid.bottom = -32 * (int32_t)whole(1u, 3u);
    parameters.grid.resolution = EK_R(uniform(0.05, 0.2));
    parameters.grid.range_max = parameters.scan.range_max;
    if (lines) {
        draw_lines(&parameters);
    }
    return parameters;
}

int random_pipelines(int lines, long sessions, int silent)
{
    int failed = 0;
    for (long session = 0; session < sessions && !failed; session++) {
        const ek_pipeline_parameters parameters = drawn_parameters(lines);
        const scan_kind kind = (scan_kind)whole(0u, KINDS); /* KINDS: another one for each scan */
        failed = begin_pipeline(&parameters);
        for (int number = 0; number < SCANS && !failed; number++) {
            ek_sweep sweep;
            memset(&sweep, 0, sizeof sweep);
            sweep.stamp_ns = (int64_t)(number + 1) * 100000000;
            sweep.beams = whole(0u, 3u) ? parameters.frontend.points : whole(1u, (uint32_t)parameters.frontend.points);
            sweep.time_increment_ns = whole(0u, 1u) ? 0 : 50000;
            sweep.ranges = ranges;
            sweep.angles = angles;
            sweep.has_odometry = (int32_t)whole(0u, 1u);
            sweep.odom_from_base.x = EK_R(uniform(-0.5, 0.5));
            sweep.odom_from_base.theta = EK_R(uniform(-0.3, 0.3));
            draw_scan(kind == KINDS ? (scan_kind)whole(0u, KINDS - 1u) : kind, number, sweep.beams,
                      (double)parameters.scan.range_max);
            failed = count_one(&sweep, silent);
        }
    }
    if (silent && !failed) {
        printf("%ld\n", sessions * SCANS);
    }
    return failed;
}

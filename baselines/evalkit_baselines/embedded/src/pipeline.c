#include "ek/pipeline.h"
#include "ek/tally.h"

#include <string.h>

ek_pipeline_parameters ek_pipeline_default(void)
{
    ek_pipeline_parameters parameters;
    memset(&parameters, 0, sizeof parameters);
    parameters.scan.range_min = EK_R(0.15);
    parameters.scan.range_max = EK_R(12.0);
    parameters.frontend = ek_frontend_default();
    parameters.grid = ek_grid_default();
    parameters.deskew = parameters.map = 1;
    return parameters;
}

static ek_status init(ek_pipeline *pipeline, ek_arena *arena, const ek_pipeline_parameters *parameters)
{
    memset(pipeline, 0, sizeof *pipeline);
    pipeline->parameters = *parameters;
    ek_status status = ek_scan_check(&parameters->scan);
    if (status == EK_OK) {
        status = ek_frontend_init(&pipeline->frontend, arena, &parameters->frontend);
    }
    if (status == EK_OK) {
        status = ek_scan_init(&pipeline->scan, arena, parameters->frontend.points);
    }
    if (status == EK_OK && parameters->map) {
        status = ek_grid_init(&pipeline->grid, arena, &parameters->grid);
    }
    return status == EK_OK && arena->used > EK_ARENA_MAX ? EK_OUT_OF_RANGE : status;
}

ek_status ek_pipeline_bytes(const ek_pipeline_parameters *parameters, size_t *bytes)
{
    ek_pipeline pipeline;
    ek_arena arena = ek_arena_make(NULL, 0u);
    if (!parameters || !bytes) {
        return EK_NULL_POINTER;
    }
    const ek_status status = init(&pipeline, &arena, parameters);
    *bytes = status == EK_OK ? arena.used : 0u;
    return status;
}

ek_status ek_pipeline_start(ek_pipeline *pipeline, void *memory, size_t bytes, const ek_pipeline_parameters *parameters)
{
    ek_arena arena = ek_arena_make(memory, bytes);
    if (!pipeline || !memory || !parameters) {
        return EK_NULL_POINTER;
    }
    const ek_status status = init(pipeline, &arena, parameters);
    return status == EK_OK ? ek_arena_check(&arena) : status;
}

ek_status ek_pipeline_update(ek_pipeline *pipeline, const ek_sweep *sweep, ek_estimate *estimate)
{
    if (!pipeline || !sweep || !estimate) {
        return EK_NULL_POINTER;
    }
    const ek_pipeline_parameters *const p = &pipeline->parameters;
    EK_COUNT(EK_SCANS, 1u);
    ek_status status = ek_motion_project(&pipeline->frontend.motion, &pipeline->scan, sweep, &p->scan, p->deskew);
    if (status != EK_OK) {
        return status;
    }
    ek_prior prior;
    prior.stamp_ns = sweep->stamp_ns;
    prior.has_odometry = sweep->has_odometry;
    prior.odom_from_base = sweep->odom_from_base;
    status = ek_frontend_update(&pipeline->frontend, pipeline->scan.hits, pipeline->scan.count, &prior, estimate);
    if (status == EK_OK && p->map) {
        status = ek_grid_add_scan(&pipeline->grid, pipeline->frontend.motion.start_from_points, p->scan.base_from_sensor.x,
                             p->scan.base_from_sensor.y, pipeline->scan.hits, pipeline->scan.count,
                             pipeline->scan.ends, p->clear_no_returns ? pipeline->scan.misses : 0u);
    }
    return status;
}

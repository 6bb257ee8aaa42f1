/* pipeline.h - the whole method: deskew, odometry, map. One call to start, one call per scan. */
#ifndef EK_PIPELINE_H
#define EK_PIPELINE_H

#include "ek/frontend.h"
#include "ek/grid.h"
#include "ek/scan.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    ek_scan_parameters scan;
    ek_frontend_parameters frontend; /* frontend.points is also the maximum number of beams of a sweep */
    ek_grid_parameters grid;
    int32_t deskew;           /* 1: undo the motion within a sweep */
    int32_t map;              /* 1: build the map */
    int32_t clear_no_returns; /* 1: beams without return free the cells they cross */
} ek_pipeline_parameters;

typedef struct {
    ek_pipeline_parameters parameters;
    ek_scan scan;
    ek_frontend frontend;
    ek_grid grid;
} ek_pipeline;

#define ek_pipeline_default EK_NAME(pipeline_default)
#define ek_pipeline_bytes EK_NAME(pipeline_bytes)
#define ek_pipeline_start EK_NAME(pipeline_start)
#define ek_pipeline_update EK_NAME(pipeline_update)

/* Default parameters for an RPLIDAR A2: 0.15 to 12 m, up to 2048 beams, sensor at the base, deskewed, with map. */
ek_pipeline_parameters ek_pipeline_default(void);

/* Compute how many bytes ek_pipeline_start needs besides the struct. EK_NOT_FINITE or EK_OUT_OF_RANGE for wrong
 * parameters and for more memory than this processor can address; *bytes is then 0. */
ek_status ek_pipeline_bytes(const ek_pipeline_parameters *parameters, size_t *bytes);

/* Initialise a pipeline in memory aligned to EK_ALIGNMENT, which must outlive it. EK_TOO_LITTLE_MEMORY, or what
 * ek_pipeline_bytes returns. */
ek_status ek_pipeline_start(ek_pipeline *pipeline, void *memory, size_t bytes,
                            const ek_pipeline_parameters *parameters);

/* Process a sweep. Returns what ek_scan_project, ek_frontend_update and ek_grid_add_scan return. Allocates nothing. An
 * error changes no state, with one exception: a pose too far for the map is kept and not mapped (EK_OUT_OF_RANGE). */
ek_status ek_pipeline_update(ek_pipeline *pipeline, const ek_sweep *sweep, ek_estimate *estimate);

#ifdef __cplusplus
}
#endif
#endif

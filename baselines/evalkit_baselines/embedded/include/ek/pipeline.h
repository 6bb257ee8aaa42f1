/* pipeline.h - everything a board does with a scan: undo motion, locate, map. One call to start, one call a scan. */
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
    ek_frontend_parameters frontend; /* its `points` is also the most beams a sweep may have */
    ek_grid_parameters grid;
    int32_t deskew;           /* 1: undo the motion within a sweep */
    int32_t map;              /* 1: draw the map */
    int32_t clear_no_returns; /* 1: beams without return free their cells */
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

/* The paper's values for an RPLIDAR A2: 0.15 to 12 m, up to 2048 beams, sensor at the base, deskewed, with map. */
ek_pipeline_parameters ek_pipeline_default(void);

/* How much memory ek_pipeline_start needs besides the struct itself; EK_NOT_FINITE or EK_OUT_OF_RANGE as the modules
 * say, then *bytes is 0. */
ek_status ek_pipeline_bytes(const ek_pipeline_parameters *parameters, size_t *bytes);

/* Makes a pipeline in the memory (aligned to EK_ALIGNMENT), which must live as long as it. EK_TOO_LITTLE_MEMORY, or as
 * ek_pipeline_bytes. */
ek_status ek_pipeline_start(ek_pipeline *pipeline, void *memory, size_t bytes, const ek_pipeline_parameters *parameters);

/* Takes in a sweep; answers as ek_scan_project, ek_frontend_update and ek_grid_add. Nothing is allocated. A sweep that
 * is refused leaves no trace, save that a pose too far for the map is kept and not drawn (EK_OUT_OF_RANGE). */
ek_status ek_pipeline_update(ek_pipeline *pipeline, const ek_sweep *sweep, ek_answer *answer);

#ifdef __cplusplus
}
#endif
#endif

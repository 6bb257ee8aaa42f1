/* frontend.h - lidar odometry: scan-to-scan, then scan-to-map (paper, figures 2 and 4).
 *
 * Scans are matched with the last keyframes, as in the paper, or with one lasting map of all of them. Computes the same as
 * evalkit/odometry/frontend.py with a local map of keyframes or of voxels. Poses are start_from_base; the pose
 * of the first scan is the identity.
 */
#ifndef EK_FRONTEND_H
#define EK_FRONTEND_H

#include "ek/icp.h"
#include "ek/index_update.h"
#include "ek/lasting_map.h"
#include "ek/motion.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    ek_icp_parameters scan_to_scan, scan_to_map;
    int32_t use_scan_to_scan, use_scan_to_map; /* 1 or 0 */
    int32_t min_inliers;                       /* with fewer pairs the result is rejected and the guess kept */
    uint32_t keyframes;                        /* number of keyframes in the local map; 1 or more */
    ek_real keyframe_distance;                 /* m */
    ek_real keyframe_angle;                    /* rad */
    size_t points;                             /* maximum number of points of a scan */
    size_t cells;                              /* cells of the keyframes' index; 0: 16 per point, at most 2^18 */
    uint32_t neighbours;                       /* that define a line of EK_METRIC_LINE: 2 to EK_MAX_NEIGHBOURS */
    ek_real map_voxel;                         /* m: 0: match with the keyframes; else one lasting map of such voxels */
    ek_real map_radius;                        /* m: match with the voxels of the lasting map within this distance */
    size_t voxels;                             /* maximum number of voxels of the lasting map */
} ek_frontend_parameters;

/* Outcome of a stage: skipped (switched off, or first scan), guess kept (too few pairs), or result accepted. */
typedef enum { EK_STAGE_SKIPPED = -1, EK_STAGE_GUESS_KEPT = 0, EK_STAGE_ACCEPTED = 1 } ek_stage_outcome;

/* Result for one scan. A skipped stage has 0 iterations and error nan. */
typedef struct {
    ek_pose start_from_base;
    ek_match scan_to_scan, scan_to_map;
    ek_stage_outcome scan_to_scan_outcome, scan_to_map_outcome;
    int32_t keyframe; /* 1: the scan became a keyframe */
} ek_estimate;

typedef struct {
    ek_frontend_parameters parameters;
    ek_icp icp;
    ek_index last;
    ek_real *last_normals, *local_normals; /* NULL without EK_METRIC_LINE */
    ek_lasting_map lasting;             /* with map_voxel; without it the next four */
    ek_index local_map;
    ek_index_updater updater;           /* updates local_map */
    ek_real *keyframe;        /* points of the newest keyframe, pairs x y in the start frame (m) */
    size_t *keyframe_counts;  /* number of points of each keyframe in the local map */
    uint32_t oldest_keyframe, keyframe_count; /* ring buffer of keyframe_counts */
    ek_motion motion;
    ek_pose start_from_keyframe;
} ek_frontend;

#define ek_frontend_default EK_NAME(frontend_default)
#define ek_frontend_lines EK_NAME(frontend_lines)
#define ek_frontend_check EK_NAME(frontend_check)
#define ek_frontend_init EK_NAME(frontend_init)
#define ek_frontend_reset EK_NAME(frontend_reset)
#define ek_frontend_update EK_NAME(frontend_update)

/* Default parameters: both stages with ek_icp_default, 10 keyframes every 0.5 m or 20 deg, 10 inliers, 2048 points. For a
 * lasting map, once map_voxel is set: 15 m around the robot, 16384 voxels, lines through 8 neighbours. */
ek_frontend_parameters ek_frontend_default(void);

/* Parameters of embedded-pipeline-line: distances to walls, and a lasting map of voxels of 10 cm. */
ek_frontend_parameters ek_frontend_lines(void);

/* Check parameters: EK_OK, EK_NOT_FINITE or EK_OUT_OF_RANGE. */
ek_status ek_frontend_check(const ek_frontend_parameters *parameters);

/* Initialise a front end in an arena (or measure it). Returns what ek_frontend_check returns. */
ek_status ek_frontend_init(ek_frontend *frontend, ek_arena *arena, const ek_frontend_parameters *parameters);

/* Reset: the next scan is the first. */
void ek_frontend_reset(ek_frontend *frontend);

/* Process a scan: count pairs x y in the base frame (m), deskewed. The initial guess comes from wheel odometry if this
 * scan and the previous one have it, otherwise from constant velocity. A scan without points keeps the guess and never
 * becomes a keyframe. Points of a keyframe for which the lasting map has no room are left out and counted
 * (lasting.voxels.dropped). EK_TOO_MANY_POINTS; EK_NOT_FINITE: a point, the odometry or the predicted pose; EK_OUT_OF_RANGE:
 * a stamp not later than the last, or a coordinate or pose larger than EK_MAX_COORDINATE. An error changes no state; *estimate is
 * then undefined. */
ek_status ek_frontend_update(ek_frontend *frontend, const ek_real *xy, size_t count, const ek_prior *prior,
                             ek_estimate *estimate);

#ifdef __cplusplus
}
#endif
#endif

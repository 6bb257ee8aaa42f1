/* motion.h - motion prior: the motion of the base since the last scan, from wheel odometry or at constant velocity.
 *
 * A scan that is deskewed at a wrong velocity is bent, but half of its beams are displaced to one side and half to the other:
 * where it is matched, the base is right in the middle of the sweep. So where the motion within the sweep is not measured, the
 * velocity is that from the middle of the last sweep to the middle of this one, and going back from the middle at that velocity
 * gives the pose at the first beam. Sweeps less than half a sweep apart tell no velocity. As evalkit/odometry/motion_prior.py.
 */
#ifndef EK_MOTION_H
#define EK_MOTION_H

#include "ek/scan.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Time and wheel odometry of a scan. */
typedef struct {
    int64_t stamp_ns;
    int32_t has_odometry;
    ek_pose odom_from_base;
} ek_prior;

/* The last scan; zeroed: there is none. */
typedef struct {
    int32_t started, has_last_odometry;
    int32_t settled;           /* 1: the next two differ */
    ek_pose start_from_base;   /* at the first beam */
    ek_pose start_from_points; /* as matched */
    ek_pose odom_from_base;
    ek_pose start_from_middle, step; /* the step that tells the velocity, up to the middle of a sweep */
    int64_t stamp_ns, middle_ns, step_ns;
    int64_t interval_ns[2]; /* between the first beams of the last scans, the latest first */
    int64_t half_ns;        /* of the sweep that was projected: from its first beam to its middle; 0: its motion was measured */
} ek_motion;

#define ek_motion_extrapolate EK_NAME(motion_extrapolate)
#define ek_motion_predict EK_NAME(motion_predict)
#define ek_motion_store EK_NAME(motion_store)
#define ek_motion_project EK_NAME(motion_project)

/* Predict the base's motion over `elapsed_ns` at constant velocity from the last two scans; the identity before. */
ek_pose ek_motion_extrapolate(const ek_motion *motion, int64_t elapsed_ns);

/* Predict last_from_base, the motion from the last scan's points (start_from_points): from wheel odometry if this scan and
 * the last one have it, otherwise at constant velocity. */
ek_pose ek_motion_predict(const ek_motion *motion, const ek_prior *prior);

/* Compute the points of a sweep, deskewed by its own motion within the scan or else at the velocity of the last step; the
 * next ek_motion_store is for this sweep. Returns what ek_scan_project returns; EK_OUT_OF_RANGE: a time between beams that is
 * negative or overflows. */
ek_status ek_motion_project(ek_motion *motion, ek_scan *scan, const ek_sweep *sweep,
                            const ek_scan_parameters *parameters, int deskew);

/* Store the pose of a scan, as its points were matched; motion->start_from_base is then that at its first beam. */
void ek_motion_store(ek_motion *motion, const ek_prior *prior, ek_pose start_from_points);

#ifdef __cplusplus
}
#endif
#endif

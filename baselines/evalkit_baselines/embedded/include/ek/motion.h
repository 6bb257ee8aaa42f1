/* motion.h - motion prior: the motion of the base since the last scan, from wheel odometry or at constant velocity. */
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
    ek_pose start_from_base, odom_from_base, step, two_steps;
    int64_t stamp_ns, step_ns, two_steps_ns;
} ek_motion;

#define ek_motion_extrapolate EK_NAME(motion_extrapolate)
#define ek_motion_predict EK_NAME(motion_predict)
#define ek_motion_store EK_NAME(motion_store)
#define ek_motion_project EK_NAME(motion_project)

/* Predict the base's motion over `elapsed_ns` at constant velocity from the last two scans; the identity before. */
ek_pose ek_motion_extrapolate(const ek_motion *motion, int64_t elapsed_ns);

/* Predict last_from_base: from wheel odometry if this scan and the last one have it, otherwise at constant velocity. */
ek_pose ek_motion_predict(const ek_motion *motion, const ek_prior *prior);

/* Compute the points of a sweep, deskewed by its own motion within the scan or else at the velocity of the last two
 * steps: half of an error in it is the error of this scan's pose, and enters the next step with the opposite sign, so that the
 * velocity of one step oscillates. Returns what ek_scan_project returns; EK_OUT_OF_RANGE: a time between beams that is negative or overflows. */
ek_status ek_motion_project(const ek_motion *motion, ek_scan *scan, const ek_sweep *sweep,
                            const ek_scan_parameters *parameters, int deskew);

/* Store the pose of a scan. */
void ek_motion_store(ek_motion *motion, const ek_prior *prior, ek_pose start_from_base);

#ifdef __cplusplus
}
#endif
#endif

#include "ek/motion.h"

#define MAX_GAP_STEPS EK_R(2.0) /* steps: after a longer gap the velocity is not extrapolated further */

static ek_pose extrapolate(ek_pose step, int64_t step_ns, int64_t elapsed_ns)
{
    const ek_pose identity = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    if (step_ns <= 0) {
        return identity;
    }
    const ek_real share = (ek_real)elapsed_ns / (ek_real)step_ns;
    return ek_se2_fraction(step, share < MAX_GAP_STEPS ? share : MAX_GAP_STEPS);
}

ek_pose ek_motion_extrapolate(const ek_motion *motion, int64_t elapsed_ns)
{
    return extrapolate(motion->step, motion->step_ns, elapsed_ns);
}

/* Time since the last scan (ns), saturated at INT64_MAX. */
static int64_t time_since_last(const ek_motion *motion, int64_t stamp_ns)
{
    const uint64_t elapsed = (uint64_t)stamp_ns - (uint64_t)motion->stamp_ns;
    return elapsed < (uint64_t)INT64_MAX ? (int64_t)elapsed : INT64_MAX;
}

ek_pose ek_motion_predict(const ek_motion *motion, const ek_prior *prior)
{
    if (prior->has_odometry && motion->has_last_odometry) {
        return ek_se2_between(motion->odom_from_base, prior->odom_from_base);
    }
    return ek_motion_extrapolate(motion, motion->started ? time_since_last(motion, prior->stamp_ns) : 0);
}

ek_status ek_motion_project(const ek_motion *motion, ek_scan *scan, const ek_sweep *sweep,
                            const ek_scan_parameters *parameters, int deskew)
{
    const int64_t gaps = sweep->beams > 1u ? (int64_t)(sweep->beams - 1u) : 0;
    if (sweep->time_increment_ns < 0 || (gaps && sweep->time_increment_ns > INT64_MAX / gaps)) {
        return EK_OUT_OF_RANGE;
    }
    const ek_pose moved = sweep->has_motion ? sweep->start_from_end
                                            : extrapolate(motion->two_steps, motion->two_steps_ns, sweep->time_increment_ns * gaps);
    return ek_scan_project(scan, sweep, parameters, deskew && sweep->time_increment_ns > 0 ? &moved : NULL);
}

void ek_motion_store(ek_motion *motion, const ek_prior *prior, ek_pose start_from_base)
{
    if (motion->started) {
        const ek_pose before = motion->step;
        const int64_t before_ns = motion->step_ns;
        motion->step_ns = time_since_last(motion, prior->stamp_ns);
        motion->step = ek_se2_between(motion->start_from_base, start_from_base);
        motion->two_steps = ek_se2_compose(before, motion->step);
        motion->two_steps_ns = before_ns < INT64_MAX - motion->step_ns ? before_ns + motion->step_ns : INT64_MAX;
    }
    motion->started = 1;
    motion->stamp_ns = prior->stamp_ns;
    motion->start_from_base = start_from_base;
    motion->has_last_odometry = prior->has_odometry;
    motion->odom_from_base = prior->odom_from_base;
}

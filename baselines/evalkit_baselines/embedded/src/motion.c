#include "ek/motion.h"

#define MAX_GAP_STEPS EK_R(2.0) /* steps: after a longer gap the velocity is not extrapolated further */

ek_pose ek_motion_extrapolate(const ek_motion *motion, int64_t elapsed_ns)
{
    const ek_pose identity = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    if (motion->step_ns <= 0) {
        return identity;
    }
    const ek_real share = (ek_real)elapsed_ns / (ek_real)motion->step_ns;
    return ek_se2_fraction(motion->step, share < MAX_GAP_STEPS ? share : MAX_GAP_STEPS);
}

/* Time from one stamp to a later one (ns), saturated at INT64_MAX; 0 if it is not later. */
static int64_t time_between(int64_t from_ns, int64_t to_ns)
{
    const uint64_t elapsed = (uint64_t)to_ns - (uint64_t)from_ns;
    return to_ns <= from_ns ? 0 : elapsed < (uint64_t)INT64_MAX ? (int64_t)elapsed : INT64_MAX;
}

/* A motion since the first beam of the last scan, from the pose of its points. */
static ek_pose since_points(const ek_motion *motion, ek_pose step)
{
    if (!motion->settled) {
        return step;
    }
    return ek_se2_compose(ek_se2_between(motion->start_from_points, motion->start_from_base), step);
}

ek_pose ek_motion_predict(const ek_motion *motion, const ek_prior *prior)
{
    if (prior->has_odometry && motion->has_last_odometry) {
        return since_points(motion, ek_se2_between(motion->odom_from_base, prior->odom_from_base));
    }
    return since_points(motion, ek_motion_extrapolate(motion, motion->started ? time_between(motion->stamp_ns, prior->stamp_ns) : 0));
}

ek_status ek_motion_project(ek_motion *motion, ek_scan *scan, const ek_sweep *sweep,
                            const ek_scan_parameters *parameters, int deskew)
{
    const int64_t gaps = sweep->beams > 1u ? (int64_t)(sweep->beams - 1u) : 0;
    motion->half_ns = 0;
    if (sweep->time_increment_ns < 0 || (gaps && sweep->time_increment_ns > INT64_MAX / gaps)) {
        return EK_OUT_OF_RANGE;
    }
    const int64_t duration_ns = sweep->time_increment_ns * gaps;
    motion->half_ns = deskew && !sweep->has_motion ? duration_ns / 2 : 0;
    const ek_pose moved = sweep->has_motion ? sweep->start_from_end : ek_motion_extrapolate(motion, duration_ns);
    return ek_scan_project(scan, sweep, parameters, deskew && sweep->time_increment_ns > 0 ? &moved : NULL);
}

void ek_motion_store(ek_motion *motion, const ek_prior *prior, ek_pose start_from_points)
{
    const int64_t half_ns = motion->half_ns;
    const int64_t middle_ns = prior->stamp_ns > INT64_MAX - half_ns ? INT64_MAX : prior->stamp_ns + half_ns;
    ek_pose middle = start_from_points, first = start_from_points;
    if (half_ns) {
        middle = ek_se2_compose(start_from_points, ek_motion_extrapolate(motion, half_ns));
    }
    if (motion->started) {
        motion->interval_ns[1] = motion->interval_ns[0];
        motion->interval_ns[0] = time_between(motion->stamp_ns, prior->stamp_ns);
    }
    const int64_t step_ns = motion->started ? time_between(motion->middle_ns, middle_ns) : 0;
    const int told = !motion->started || step_ns >= half_ns; /* sweeps nearer to each other tell no velocity */
    if (motion->started && told) {
        motion->step_ns = step_ns;
        motion->step = ek_se2_between(motion->start_from_middle, middle);
    }
    if (half_ns) {
        first = ek_se2_compose(middle, ek_se2_inverse(ek_motion_extrapolate(motion, half_ns)));
    }
    motion->started = 1;
    motion->settled = half_ns > 0;
    motion->stamp_ns = prior->stamp_ns;
    if (told) {
        motion->middle_ns = middle_ns;
        motion->start_from_middle = middle;
    }
    motion->start_from_points = start_from_points;
    motion->start_from_base = first;
    motion->has_last_odometry = prior->has_odometry;
    motion->odom_from_base = prior->odom_from_base;
    motion->half_ns = 0;
}

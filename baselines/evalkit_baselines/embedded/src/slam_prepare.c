/* What slam.h knows of the wheels and of the lidar before a scan is matched: the scale of the odometry (odometry_scale.py),
 * ranges without noise, dirt and what moves along, and whether the robot turned evenly within a sweep (uneven_turns.py). */
#include "slam_parts.h"

#define MEMORY EK_R(50.0)    /* m: path over which the scale is averaged */
#define PRIOR EK_R(1.0)      /* m: path at scale 1 that is assumed to have been driven before */
#define MAX_ERROR EK_R(0.1)  /* a motion whose length differs by a larger share does not count */
#define MIN_STEP EK_R(0.1)   /* m */
#define UNEVEN (EK_PI / EK_R(180.0)) /* rad: a turn within a sweep that differs more from that at the rate before is uneven */
#define RIGHT_SHARE EK_R(0.25) /* of that difference: over the turn, odometry and matches may differ by so much */

void ek_slam_start_wheels(ek_slam *slam)
{
    slam->wheels.matched = slam->wheels.driven = PRIOR;
}

static ek_pose scaled(ek_pose motion, ek_real scale)
{
    motion.x *= scale;
    motion.y *= scale;
    return motion;
}

int64_t ek_slam_period_ns(const ek_slam *slam, const ek_sweep *sweep)
{
    const int64_t before_ns = slam->motion.interval_ns[0];
    const uint64_t elapsed_ns = (uint64_t)sweep->stamp_ns - (uint64_t)slam->motion.stamp_ns;
    return slam->motion.started && elapsed_ns < (uint64_t)before_ns ? (int64_t)elapsed_ns : before_ns;
}

ek_sweep ek_slam_prepare(ek_slam *slam, const ek_sweep *sweep, ek_noted *noted)
{
    const ek_real scale = slam->wheels.matched / slam->wheels.driven;
    ek_wheels *const wheels = &noted->wheels;
    ek_sweep prepared = *sweep;
    *wheels = slam->wheels;
    noted->dirt = slam->dirt;
    noted->noise = slam->noise;
    noted->company = slam->company;
    wheels->has_last = sweep->has_odometry;
    wheels->now = sweep->odom_from_base;
    if (sweep->has_odometry) {
        const ek_pose step = ek_se2_between(slam->wheels.last, sweep->odom_from_base);
        wheels->scaled = slam->wheels.has_last ? ek_se2_compose(slam->wheels.scaled, scaled(step, scale))
                                               : sweep->odom_from_base;
        wheels->last = sweep->odom_from_base;
        prepared.odom_from_base = wheels->scaled;
        prepared.start_from_end = scaled(sweep->start_from_end, scale);
    }
    if (sweep->ranges && sweep->angles && sweep->beams <= slam->parameters.points) {
        const ek_scan_parameters *const limits = &slam->parameters.scan;
        EK_COUNT(EK_PREPARED, sweep->beams);
        const int smoothed = ek_smooth_ranges(sweep->ranges, sweep->angles, sweep->beams, slam->cleaned);
        ek_range_noise_observe(&noted->noise, smoothed);
        ek_drop_speckles(smoothed ? slam->cleaned : sweep->ranges, sweep->angles, sweep->beams, limits->range_min,
                         limits->range_max, &noted->dirt, slam->cleaned);
        prepared.ranges = slam->cleaned;
        if (slam->parameters.use_odometry && sweep->has_odometry) {
            ek_drop_companions(slam->views, &noted->company, slam->cleaned, sweep->angles, sweep->beams, limits->range_min,
                               limits->range_max, ek_se2_compose(wheels->scaled, limits->base_from_sensor));
        } else {
            noted->company.older = noted->company.newer = 0u;
        }
    }
    return prepared;
}

void ek_slam_observe_wheels(ek_slam *slam, ek_pose matched, const ek_openness *open, int known)
{
    ek_wheels *const wheels = &slam->wheels;
    const int seen = ek_openness_is_closed(open), both = seen && wheels->seen;
    if (known && both && wheels->has_last && wheels->has_keyframe) {
        const ek_pose motion = ek_se2_between(wheels->keyframe, wheels->now);
        const ek_real driven = EK_SQRT(motion.x * motion.x + motion.y * motion.y);
        const ek_real along = (matched.x * motion.x + matched.y * motion.y) / (driven > EK_R(0.0) ? driven : EK_R(1.0));
        if (driven >= MIN_STEP && EK_FABS(along - driven) <= MAX_ERROR * driven) {
            wheels->matched += along;
            wheels->driven += driven;
            if (wheels->driven > MEMORY) {
                wheels->matched *= MEMORY / wheels->driven;
                wheels->driven = MEMORY;
            }
        }
    }
    wheels->seen = seen;
    wheels->has_keyframe = wheels->has_last;
    wheels->keyframe = wheels->now;
}

ek_real ek_slam_unevenness(const ek_slam *slam, const ek_sweep *sweep)
{
    const ek_real sweep_ns = (ek_real)sweep->time_increment_ns * (ek_real)(sweep->beams - 1u);
    const ek_real since_ns = (ek_real)((uint64_t)sweep->stamp_ns - (uint64_t)slam->motion.stamp_ns);
    const ek_real turn = ek_se2_between(slam->motion.odom_from_base, sweep->odom_from_base).theta;
    const ek_real by = EK_FABS(sweep->start_from_end.theta - turn * sweep_ns / since_ns);
    const int measured = slam->motion.has_last_odometry && sweep->has_odometry && sweep->has_motion;
    const int bends = slam->parameters.deskew && sweep_ns > EK_R(0.0) && by > UNEVEN;
    return measured && bends && !(slam->uneven.by > EK_R(0.0)) ? by : EK_R(0.0);
}

void ek_slam_note_turn(ek_slam *slam, const ek_prior *prior, ek_real by, const ek_slam_estimate *estimate)
{
    ek_uneven *const noted = &slam->uneven;
    const int matched = estimate->scan_to_map_accepted && !estimate->lost && !estimate->set_aside;
    if (noted->by > EK_R(0.0) && prior->has_odometry && matched) {
        const ek_real beyond = estimate->odom_from_base.theta - prior->odom_from_base.theta;
        const int right = EK_FABS(ek_se2_wrap(beyond - noted->beyond)) <= RIGHT_SHARE * noted->by;
        noted->right = !right ? 0 : noted->right < EK_TURNS_RIGHT ? noted->right + 1 : EK_TURNS_RIGHT;
    }
    noted->by = by;
    noted->beyond = slam->motion.start_from_base.theta - slam->motion.odom_from_base.theta;
}

/* The steps of slam.h for one scan: check, prepare and project it, track, judge, and keep it or set it aside. */
#include "slam_parts.h"

#include <string.h>

#define PERIOD_MS 100           /* of the scans that `work` is meant for: a slower lidar leaves more time for loops */
#define MAX_PERIOD_MS 2000
#define SPARE 3                 /* times `work`: for the search while the track is lost, less the work of matching */
#define PATIENCE_NS 2000000000u /* scans that lie nowhere are set aside until so long after the last one that did */
#define SOON_NS 1000000000u     /* for so long the motion goes on about as before */
#define NEAR_LIMIT (EK_R(0.25) * EK_MAX_COORDINATE)

static ek_status check_sweep(const ek_slam *slam, const ek_sweep *sweep)
{
    if (sweep->has_odometry && !ek_se2_is_finite(sweep->odom_from_base)) {
        return EK_NOT_FINITE;
    }
    const ek_pose at = slam->parameters.scan.base_from_sensor;
    const int near = EK_FABS(at.x) <= EK_R(1e3) && EK_FABS(at.y) <= EK_R(1e3) &&
                     (!sweep->has_odometry || (EK_FABS(sweep->odom_from_base.x) <= EK_MAX_COORDINATE &&
                                               EK_FABS(sweep->odom_from_base.y) <= EK_MAX_COORDINATE));
    return near && !(slam->motion.started && sweep->stamp_ns <= slam->motion.stamp_ns) ? EK_OK : EK_OUT_OF_RANGE;
}

static ek_status check_points(const ek_scan *scan)
{
    for (size_t k = 0; k < 2u * scan->count; k++) {
        if (!(EK_FABS(scan->hits[k]) <= NEAR_LIMIT)) {
            return EK_OUT_OF_RANGE; /* ek_scan_project leaves out what is not finite */
        }
    }
    return EK_OK;
}

static int is_near(ek_pose pose)
{
    return ek_se2_is_finite(pose) && EK_FABS(pose.x) <= NEAR_LIMIT && EK_FABS(pose.y) <= NEAR_LIMIT;
}

int64_t ek_slam_allowed_work(const ek_slam *slam)
{
    const int64_t work = slam->parameters.work, *const interval_ns = slam->motion.interval_ns;
    const int64_t interval_ms = (interval_ns[0] < interval_ns[1] ? interval_ns[0] : interval_ns[1]) / 1000000;
    const int64_t longest = interval_ms < MAX_PERIOD_MS ? interval_ms : MAX_PERIOD_MS;
    if (work == 0 || work > INT64_MAX / MAX_PERIOD_MS) {
        return INT64_MAX;
    }
    return longest > PERIOD_MS ? work * longest / PERIOD_MS : work;
}

int64_t ek_slam_spare_work(const ek_slam *slam, int64_t allowed)
{
    const uint64_t matching = EK_MATCH_WORK * slam->matching;
    const int64_t most = allowed < INT64_MAX / SPARE ? SPARE * allowed : INT64_MAX;
    return matching < (uint64_t)most ? most - (int64_t)matching : 0;
}

static int is_direct(const ek_slam_estimate *estimate)
{
    return estimate->has_scan_to_map && !estimate->has_scan_to_scan;
}

/* Whether the scan lies neither on the one before nor on the map; one that was matched directly lies on the map. */
static int is_lost(ek_slam *slam, int is_predicted, const ek_slam_estimate *estimate, ek_work *work)
{
    if (is_direct(estimate)) {
        return 0;
    }
    if (!slam->last_compared) {
        if (slam->last_outdated) { /* if the one before has too few points, there is none to compare with */
            slam->continuity.before.count = 0u;
        }
        ek_continuity_keep(&slam->continuity, &slam->thinner, slam->last_points, slam->last_count,
                           slam->last_odom_from_base, slam->last_base_from_sensor, work);
        slam->last_compared = 1;
    }
    return ek_continuity_is_lost(&slam->continuity, &slam->thinner, slam->scan.hits, slam->scan.count,
                                 estimate->odom_from_base, is_predicted, &slam->map_index, work);
}

/* Whether the scan is set aside, or the track is lost. */
static void judge(ek_slam *slam, const ek_prior *prior, int has_odometry, ek_slam_estimate *estimate, ek_work *work)
{
    const int soon = (uint64_t)prior->stamp_ns - (uint64_t)slam->motion.stamp_ns <= SOON_NS;
    const int lost = is_lost(slam, has_odometry || soon, estimate, work);
    if (!lost || !slam->motion.started) {
        slam->fitted_ns = prior->stamp_ns;
    }
    const uint64_t since = (uint64_t)prior->stamp_ns - (uint64_t)slam->fitted_ns;
    const int measured = ek_slam_is_measured(slam, prior);
    estimate->set_aside = lost && measured && since <= PATIENCE_NS;
    estimate->lost = lost && !estimate->set_aside;
}

/* Learn the times of the beams from a matched scan. */
static void observe_sweep(ek_slam *slam, const ek_sweep *came, const ek_slam_estimate *estimate)
{
    const int matched = estimate->scan_to_map_accepted && !estimate->lost && !estimate->set_aside;
    if (matched && slam->parameters.deskew && ek_sweep_times_applies(came)) {
        const ek_pose pose = estimate->odom_from_base;
        const ek_sweep_step step = {ek_se2_between(slam->motion.start_from_base, pose),
                                    (int64_t)((uint64_t)came->stamp_ns - (uint64_t)slam->motion.stamp_ns),
                                    ek_slam_period_ns(slam, came)};
        ek_slam_observe(slam);
        ek_sweep_times_observe(&slam->sweeps, &slam->observer, &slam->map_index, pose, slam->parameters.fine_correspondence,
                               came, slam->parameters.scan.base_from_sensor, &step);
    }
}

/* Draw a scan between two keyframes; scans are matched with it when the next part of the map is taken. */
static void draw_between(ek_slam *slam, ek_pose odom_from_base)
{
    const int32_t changed = slam->map_changed;
    const ek_real sensor[2] = {slam->parameters.scan.base_from_sensor.x, slam->parameters.scan.base_from_sensor.y};
    ek_work work = ek_work_make(INT64_MAX);
    ek_slam_draw(slam, slam->drawn, slam->scan.hits, slam->scan.count, sensor, odom_from_base, &work);
    slam->map_changed = changed;
}

/* Keep the scan: as the one before, and unless it is uneven, in the map if it fits, and as a keyframe if the base has moved enough;
 * in any case if the track was lost. */
static ek_status keep(ek_slam *slam, const ek_prior *prior, ek_pose predicted, const ek_slam_estimate *estimate, ek_work *task)
{
    const ek_pose pose = estimate->odom_from_base;
    const int even = !(slam->uneven.by > EK_R(0.0)), keyframe = even && ek_slam_is_keyframe(slam, pose);
    const int measured = ek_slam_is_measured(slam, prior);
    const int fits = estimate->scan_to_map_accepted &&
                     ek_slam_doubt(slam, measured ? &predicted : NULL, pose, &estimate->scan_to_map);
    if (keyframe) {
        slam->odom_from_front = pose;
        slam->front_count = slam->scan.count;
        slam->has_keyframe = 1;
    }
    ek_slam_keep_last(slam, pose);
    ek_motion_store(&slam->motion, prior, pose);
    *task = ek_work_make(ek_slam_allowed_work(slam));
    if (keyframe || estimate->lost) {
        const ek_step_kind kind = !estimate->lost ? EK_STEP_MATCHED : measured ? EK_STEP_MEASURED : EK_STEP_UNKNOWN;
        return ek_slam_insert(slam, pose, kind, kind == EK_STEP_MEASURED ? predicted : pose, task);
    }
    if (fits && even) {
        draw_between(slam, pose);
    }
    return EK_OK;
}

/* Go on from the pose by the wheels alone: the next scan is matched with nothing, and compared with the last one that was kept. */
static ek_status set_aside(ek_slam *slam, const ek_prior *prior, ek_pose predicted, ek_slam_estimate *estimate, ek_work *task)
{
    estimate->odom_from_base = predicted;
    slam->motion.half_ns = 0; /* at the first beam */
    ek_motion_store(&slam->motion, prior, predicted);
    *task = ek_work_make(ek_slam_allowed_work(slam));
    return ek_slam_forget_last(slam);
}

/* Project a prepared sweep. Where it has no times of beams, and they are found, the motion within it is undone, and its stamp
 * lies in its middle: so the scan lies where it lay, bent, and no answer depends on what its stamp is the time of. */
static ek_status project(ek_slam *slam, const ek_sweep *prepared)
{
    const ek_slam_parameters *const p = &slam->parameters;
    const int timed = p->deskew && prepared->beams <= p->points; /* more beams are refused, and not read */
    const int64_t took_ns = timed ? ek_sweep_times_take(&slam->sweeps, prepared, ek_slam_period_ns(slam, prepared)) : 0;
    ek_sweep swept = *prepared;
    if (took_ns != 0) {
        swept.has_motion = 1;
        swept.time_increment_ns = 1;
        swept.start_from_end = ek_motion_extrapolate(&slam->motion, took_ns);
    }
    const ek_status status = ek_motion_project(&slam->motion, &slam->scan, &swept, &p->scan, p->deskew);
    if (status == EK_OK && took_ns != 0) {
        const ek_pose middle_from_first = ek_se2_inverse(ek_se2_fraction(swept.start_from_end, EK_R(0.5)));
        ek_se2_transform(middle_from_first, slam->scan.hits, slam->scan.count, slam->scan.hits);
    }
    return status;
}

/* Go on with loops, optimisation and map; with more work while a lost part of the drive is searched for. */
static void go_on(ek_slam *slam, ek_work *task)
{
    ek_slam_work(slam, task);
    if (slam->task == EK_TASK_FIND && slam->finder.apart) {
        task->left += ek_slam_spare_work(slam, ek_slam_allowed_work(slam));
        ek_slam_work(slam, task);
    }
    EK_COUNT(EK_TASK, task->done);
}

/* Fill in the pose of the scan, and what the SLAM has done. */
static void report(const ek_slam *slam, const ek_work *task, ek_slam_estimate *estimate)
{
    estimate->odom_from_base = slam->motion.start_from_base;
    estimate->start_from_base = ek_se2_compose(ek_se2_inverse(slam->odom_from_start), estimate->odom_from_base);
    estimate->corrected = slam->corrected;
    estimate->full = slam->full;
    estimate->keyframe = slam->keyframes.count ? (uint32_t)(slam->keyframes.count - 1u) : 0u;
    estimate->work = task->done;
}

ek_status ek_slam_update(ek_slam *slam, const ek_sweep *sweep, ek_slam_estimate *estimate)
{
    const ek_pose identity = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    const ek_match none = {identity, 0, 0, 0, (ek_real)NAN, 0u};
    ek_work work = ek_work_make(INT64_MAX);
    if (!slam || !sweep || !estimate) {
        return EK_NULL_POINTER;
    }
    EK_COUNT(EK_SLAM_SCANS, 1u);
    const ek_slam_parameters *const p = &slam->parameters;
    ek_status status = check_sweep(slam, sweep);
    ek_noted noted;
    ek_sweep prepared = *sweep;
    if (status == EK_OK) {
        prepared = ek_slam_prepare(slam, sweep, &noted);
        status = project(slam, &prepared);
    }
    status = status == EK_OK ? check_points(&slam->scan) : status;
    if (status != EK_OK) {
        return status;
    }
    const ek_prior prior = {sweep->stamp_ns, p->use_odometry && sweep->has_odometry, prepared.odom_from_base};
    const ek_pose predicted = ek_se2_compose(slam->motion.start_from_points, ek_motion_predict(&slam->motion, &prior));
    if (!is_near(predicted)) { /* before a part of the map is taken there */
        return EK_OUT_OF_RANGE;
    }
    memset(estimate, 0, sizeof *estimate);
    estimate->odom_from_base = identity;
    estimate->scan_to_scan = estimate->scan_to_map = none;
    slam->corrected = 0;
    const ek_real uneven = ek_slam_unevenness(slam, &prepared);
    estimate->set_aside = uneven > EK_R(0.0) && slam->uneven.right == EK_TURNS_RIGHT;
    status = ek_slam_track(slam, &prior, estimate, &work);
    if (status != EK_OK || !is_near(estimate->odom_from_base)) {
        return status == EK_OK ? EK_OUT_OF_RANGE : status;
    }
    slam->wheels = noted.wheels;
    slam->company = noted.company;
    ek_work task = ek_work_make(0);
    if (!estimate->set_aside) {
        status = is_direct(estimate) ? EK_OK : ek_slam_take_map(slam, estimate->odom_from_base, &work);
        judge(slam, &prior, sweep->has_odometry, estimate, &work);
    }
    ek_slam_note_turn(slam, &prior, uneven, estimate);
    observe_sweep(slam, sweep, estimate);
    if (status == EK_OK && estimate->set_aside) {
        status = set_aside(slam, &prior, predicted, estimate, &task);
    } else if (status == EK_OK) {
        status = keep(slam, &prior, predicted, estimate, &task);
    }
    slam->noise = noted.noise;
    slam->dirt = noted.dirt;
    go_on(slam, &task);
    report(slam, &task, estimate);
    return status;
}

#include "slam_parts.h"
#include "ek/normals.h"

#include <string.h>

#define NEIGHBOURS 8u
#define CELLS_PER_POINT 16u
#define MAX_CELLS ((size_t)1 << 18)
#define MAX_VOXEL_POINTS 200u
#define RECENTRE EK_R(0.1)      /* share of the map's radius that the robot moves before its part is taken again */
#define PERIOD_MS 100           /* of the scans that `work` is meant for: a slower lidar leaves more time for loops */
#define MAX_PERIOD_MS 2000
#define AS_MANY EK_R(0.02)      /* share by which a scan near a keyframe in a room may have more or fewer points */
#define SPARE 3                 /* times `work`: for the search while the track is lost, less the work of matching */
#define PATIENCE_NS 2000000000u /* scans that lie nowhere are set aside until so long after the last one that did */
#define SOON_NS 1000000000u     /* for so long the motion goes on about as before */
#define NEAR_LIMIT (EK_R(0.25) * EK_MAX_COORDINATE)

ek_slam_parameters ek_slam_default(void)
{
    ek_slam_parameters p;
    memset(&p, 0, sizeof p);
    p.scan.range_min = EK_R(0.15);
    p.scan.range_max = EK_R(12.0);
    p.matcher = ek_icp_default();
    p.matcher.epsilon = EK_R(1e-6);
    p.matcher.one_to_one = 0;
    p.matcher.metric = EK_METRIC_LINE;
    p.matcher.cauchy = EK_R(0.1);
    p.matcher.share_noise = 1;
    p.matcher.max_correspondence = EK_R(1.0);
    p.fine_correspondence = EK_R(0.3);
    p.deskew = p.use_odometry = 1;
    p.min_inliers = 10;
    p.keyframe_distance = EK_R(0.3);
    p.keyframe_angle = EK_R(10.0) * EK_PI / EK_R(180.0);
    p.map_voxel = EK_R(0.1);
    p.map_radius = EK_R(30.0);
    p.map_reach = EK_R(20.0);
    p.drift.sigma = EK_R(0.02);
    p.drift.sigma_theta = EK_R(0.3) * EK_PI / EK_R(180.0);
    p.loop = ek_loop_default();
    p.work = 200000;
    p.points = 2048u;
    p.keyframes = 2000u;
    p.keyframe_points = 500u * p.keyframes;
    p.loops = 64u;
    p.records = 512u;
    p.voxels = 16384u;
    p.map_points = 12288u;
    p.loop_points = 16384u;
    p.score_cells = (size_t)512 * 512;
    return p;
}

static ek_status check_parameters(const ek_slam_parameters *p)
{
    const ek_real all[] = {p->fine_correspondence, p->keyframe_distance, p->keyframe_angle, p->map_radius, p->map_reach};
    if (p->matcher.metric != EK_METRIC_LINE || p->min_inliers < 0 || p->points < 1u || p->points > (size_t)1 << 20 ||
        p->records < 1u || p->records > (size_t)1 << 20 || p->work < 0) {
        return EK_OUT_OF_RANGE;
    }
    for (size_t k = 0; k < sizeof all / sizeof *all; k++) {
        if (!isfinite(all[k])) {
            return EK_NOT_FINITE;
        }
        if (all[k] < EK_R(0.0) || all[k] > EK_R(1e6)) {
            return EK_OUT_OF_RANGE;
        }
    }
    const ek_status status = ek_scan_check(&p->scan);
    return status == EK_OK ? ek_icp_check(&p->matcher) : status;
}

static size_t cells_for(size_t points)
{
    return points < MAX_CELLS / CELLS_PER_POINT ? CELLS_PER_POINT * points : MAX_CELLS;
}

/* Memory of the front end and its map. */
static ek_status init_front(ek_slam *slam, ek_arena *arena, const ek_slam_parameters *p)
{
    const size_t most = p->points > p->map_points ? p->points : p->map_points;
    ek_status status = ek_icp_init(&slam->icp, arena, p->points, most);
    status = status == EK_OK ? ek_scan_init(&slam->scan, arena, p->points) : status;
    status = status == EK_OK ? ek_icp_init_lines(&slam->icp, arena) : status;
    status = status == EK_OK ? ek_index_init(&slam->last, arena, p->points, cells_for(p->points)) : status;
    status = status == EK_OK ? ek_index_init(&slam->map_index, arena, p->map_points, cells_for(p->map_points)) : status;
    status = status == EK_OK ? ek_thinner_init(&slam->thinner, arena, most) : status;
    status = status == EK_OK ? ek_observer_init(&slam->observer, arena, p->points) : status;
    status = status == EK_OK ? ek_continuity_init(&slam->continuity, arena, p->points) : status;
    for (size_t k = 0; status == EK_OK && k < 2u; k++) {
        status = ek_voxel_map_init(&slam->maps[k], arena, p->voxels, p->map_voxel, MAX_VOXEL_POINTS);
        status = status == EK_OK ? ek_voxel_map_keep_views(&slam->maps[k], arena) : status;
    }
    slam->last_points = (ek_real *)ek_arena_alloc(arena, p->points, 2u * sizeof(ek_real));
    slam->last_normals = (ek_real *)ek_arena_alloc(arena, p->points, 2u * sizeof(ek_real));
    slam->map_normals = (ek_real *)ek_arena_alloc(arena, p->map_points, 2u * sizeof(ek_real));
    slam->map_points = (ek_real *)ek_arena_alloc(arena, p->map_points, 2u * sizeof(ek_real));
    slam->map_support = (uint32_t *)ek_arena_alloc(arena, p->map_points, sizeof(uint32_t));
    slam->map_seen_from = (ek_real *)ek_arena_alloc(arena, p->map_points, 2u * sizeof(ek_real));
    slam->moved = (ek_real *)ek_arena_alloc(arena, p->points, 2u * sizeof(ek_real));
    status = status == EK_OK ? ek_score_grid_init(&slam->around, arena, p->score_cells) : status;
    status = status == EK_OK ? ek_search_init(&slam->search, arena, p->points) : status;
    slam->means = (ek_real *)ek_arena_alloc(arena, p->map_points, 2u * sizeof(ek_real));
    slam->cells = (int32_t *)ek_arena_alloc(arena, p->points, 2u * sizeof(int32_t));
    slam->stored = (ek_real *)ek_arena_alloc(arena, p->points, 2u * sizeof(ek_real));
    slam->cleaned = (ek_real *)ek_arena_alloc(arena, p->points, sizeof(ek_real));
    return status;
}

ek_status ek_slam_init(ek_slam *slam, ek_arena *arena, const ek_slam_parameters *parameters)
{
    ek_icp_parameters fine = parameters->matcher;
    fine.max_correspondence = parameters->fine_correspondence;
    memset(slam, 0, sizeof *slam);
    slam->parameters = *parameters;
    ek_slam_start_wheels(slam);
    slam->dirt = ek_dirt_default();
    ek_status status = check_parameters(parameters);
    status = status == EK_OK ? init_front(slam, arena, parameters) : status;
    if (status == EK_OK) {
        status = ek_keyframes_init(&slam->keyframes, arena, parameters->keyframes, parameters->keyframe_points,
                                   parameters->loops, parameters->drift);
    }
    if (status == EK_OK) {
        status = ek_loop_finder_init(&slam->finder, arena, &parameters->loop, &parameters->matcher, &fine,
                                     parameters->loop_points, parameters->score_cells);
    }
    if (status == EK_OK) {
        slam->odom_from_keyframe = (ek_pose *)ek_arena_alloc(arena, parameters->keyframes, sizeof(ek_pose));
        slam->record = (ek_loop_record *)ek_arena_alloc(arena, parameters->records, sizeof(ek_loop_record));
        slam->record_of_loop = (uint32_t *)ek_arena_alloc(arena, parameters->loops, sizeof(uint32_t));
    }
    return status == EK_OK && arena->used > EK_ARENA_MAX ? EK_OUT_OF_RANGE : status;
}

/* Index a cloud; its normals are computed when a match needs them. */
static ek_status index_lines(ek_index *index, ek_real *normals, const ek_real *xy, size_t count)
{
    const ek_status status = ek_index_build(index, xy, count);
    return status == EK_OK ? ek_normals_defer(index, NEIGHBOURS, normals) : status;
}

/* Keep the scan, at its pose, to match and compare the next one with. */
static void keep_last(ek_slam *slam, ek_pose odom_from_base)
{
    memcpy(slam->last_points, slam->scan.hits, 2u * slam->scan.count * sizeof(ek_real));
    slam->last_count = slam->scan.count;
    slam->last_outdated = !slam->last_compared;
    slam->last_indexed = slam->last_compared = 0;
    slam->last_odom_from_base = odom_from_base;
    slam->last_base_from_sensor = slam->parameters.scan.base_from_sensor;
}

static ek_status index_last(ek_slam *slam)
{
    if (slam->last_indexed) {
        return EK_OK;
    }
    const ek_status status = index_lines(&slam->last, slam->last_normals, slam->last_points, slam->last_count);
    slam->last_indexed = status == EK_OK;
    return status;
}

/* Take the part of the map around a pose, if the map has changed or the robot has moved on. */
static ek_status take_map(ek_slam *slam, ek_pose near, ek_work *work)
{
    const ek_real x = near.x - slam->centre_x, y = near.y - slam->centre_y, radius = slam->parameters.map_radius;
    if (!slam->map_changed && x * x + y * y <= RECENTRE * radius * RECENTRE * radius) {
        return EK_OK;
    }
    const ek_pose centre = ek_se2_compose(ek_grid_from_odom, near);
    const ek_pose odom_from_grid = ek_se2_inverse(ek_grid_from_odom); /* a turn: for directions too */
    const size_t count = ek_voxel_map_cloud(&slam->maps[slam->drawn], centre.x, centre.y, radius, slam->map_points,
                                            slam->map_support, slam->map_seen_from, slam->parameters.map_points, work);
    ek_se2_transform(odom_from_grid, slam->map_points, count, slam->map_points);
    ek_se2_transform(odom_from_grid, slam->map_seen_from, count, slam->map_seen_from);
    slam->centre_x = near.x;
    slam->centre_y = near.y;
    slam->map_changed = 0;
    slam->around_drawn = 0;
    const ek_status status = index_lines(&slam->map_index, slam->map_normals, slam->map_points, count);
    slam->map_index.support = slam->map_support;
    slam->map_index.noisy = ek_is_noisy(&slam->noise) && !ek_is_dirty(&slam->dirt); /* by the scans before */
    slam->map_index.seen_from = slam->map_seen_from;
    return status;
}

/* Whether wheel odometry measured the motion since the last scan. */
static int is_measured(const ek_slam *slam, const ek_prior *prior)
{
    return slam->motion.has_last_odometry && prior->has_odometry;
}

/* One stage: the pose after it is the match, or the guess where the match has too few pairs; `predicted`: as in
 * ek_slam_match. The stage with the map begins where the one with the last scan ends, for which a part of a scan suffices. */
static ek_status run_stage(ek_slam *slam, const ek_index *target, const ek_pose *predicted, ek_pose *pose,
                           ek_match *match, int32_t *accepted)
{
    *accepted = 0;
    if (slam->scan.count == 0u) {
        match->target_from_source = *pose;
        return EK_OK;
    }
    const ek_status status = ek_slam_match(slam, target, *pose, predicted, target == &slam->last, match);
    const ek_pose limited = status == EK_OK ? ek_slam_limit(slam, target, match->target_from_source, *pose) : *pose;
    if (status == EK_OK && !ek_slam_accepts(&slam->gate, slam->scan.count, *pose, limited, match)) {
        match->inliers = 0;
    }
    *accepted = status == EK_OK && match->inliers >= slam->parameters.min_inliers;
    *pose = *accepted ? limited : *pose;
    return status;
}

/* Whether a scan at a pose is a keyframe: the first one, or far enough from the last. */
static int is_keyframe(const ek_slam *slam, ek_pose odom_from_base)
{
    const ek_slam_parameters *const p = &slam->parameters;
    const ek_pose moved = ek_se2_between(slam->odom_from_front, odom_from_base);
    const int far = moved.x * moved.x + moved.y * moved.y >= p->keyframe_distance * p->keyframe_distance;
    return !slam->has_keyframe || far || EK_FABS(moved.theta) >= p->keyframe_angle;
}

/* Whether nothing is open: near a keyframe in a room, with about as many points. Elsewhere it is measured again: a scan that is
 * left to its guess, or held back, may never get far from that keyframe. */
static int is_closed(const ek_slam *slam, ek_pose predicted)
{
    const ek_real count = (ek_real)slam->scan.count, before = (ek_real)slam->front_count;
    return slam->in_room && EK_FABS(count - before) <= AS_MANY * before && !is_keyframe(slam, predicted);
}

ek_status ek_slam_track(ek_slam *slam, const ek_prior *prior, ek_slam_estimate *estimate, ek_work *work)
{
    ek_pose last_from_base = ek_motion_predict(&slam->motion, prior), pose = estimate->odom_from_base;
    if (!slam->motion.started) {
        return EK_OK;
    }
    slam->tried = 0;
    slam->matching = 0u;
    const int measured = is_measured(slam, prior);
    const ek_pose predicted = ek_se2_compose(slam->motion.start_from_points, last_from_base);
    slam->closed = is_closed(slam, predicted);
    slam->observed = 0;
    slam->gate = ek_slam_gate(slam, measured, ek_se2_between(slam->motion.start_from_base, predicted));
    ek_status status = EK_OK;
    estimate->set_aside = estimate->set_aside && ek_slam_is_good(&slam->gate);
    if (ek_slam_is_good(&slam->gate)) {
        estimate->odom_from_base = predicted;
        if (estimate->set_aside) {
            return EK_OK;
        }
        status = take_map(slam, predicted, work);
        if (status == EK_OK && ek_slam_match_directly(slam, &estimate->odom_from_base, &estimate->scan_to_map)) {
            estimate->has_scan_to_map = estimate->scan_to_map_accepted = 1;
            return EK_OK;
        }
    }
    status = status == EK_OK ? index_last(slam) : status;
    if (status == EK_OK) {
        status = run_stage(slam, &slam->last, NULL, &last_from_base, &estimate->scan_to_scan,
                           &estimate->scan_to_scan_accepted);
    }
    pose = ek_se2_compose(slam->motion.start_from_points, last_from_base);
    if (status == EK_OK) {
        status = take_map(slam, pose, work);
    }
    if (status == EK_OK) {
        status = run_stage(slam, &slam->map_index, measured ? NULL : &predicted, &pose, &estimate->scan_to_map,
                           &estimate->scan_to_map_accepted);
    }
    estimate->has_scan_to_scan = estimate->has_scan_to_map = 1;
    estimate->odom_from_base = pose;
    return status;
}

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
    const int measured = is_measured(slam, prior);
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
    const int even = !(slam->uneven.by > EK_R(0.0)), keyframe = even && is_keyframe(slam, pose);
    const int measured = is_measured(slam, prior);
    const int fits = estimate->scan_to_map_accepted &&
                     ek_slam_doubt(slam, measured ? &predicted : NULL, pose, &estimate->scan_to_map);
    if (keyframe) {
        slam->odom_from_front = pose;
        slam->front_count = slam->scan.count;
        slam->has_keyframe = 1;
    }
    keep_last(slam, pose);
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
    const ek_status status = index_lines(&slam->last, slam->last_normals, slam->last_points, 0u);
    slam->last_indexed = status == EK_OK;
    return status;
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
        status = is_direct(estimate) ? EK_OK : take_map(slam, estimate->odom_from_base, &work);
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
    estimate->odom_from_base = slam->motion.start_from_base;
    ek_slam_work(slam, &task);
    if (slam->task == EK_TASK_FIND && slam->finder.apart) {
        task.left += ek_slam_spare_work(slam, ek_slam_allowed_work(slam));
        ek_slam_work(slam, &task);
    }
    estimate->work = task.done;
    EK_COUNT(EK_TASK, task.done);
    estimate->start_from_base = ek_se2_compose(ek_se2_inverse(slam->odom_from_start), estimate->odom_from_base);
    estimate->corrected = slam->corrected;
    estimate->full = slam->full;
    estimate->keyframe = slam->keyframes.count ? (uint32_t)(slam->keyframes.count - 1u) : 0u;
    return status;
}

ek_status ek_slam_bytes(const ek_slam_parameters *parameters, size_t *bytes)
{
    ek_slam slam;
    ek_arena arena = ek_arena_make(NULL, 0u);
    if (!parameters || !bytes) {
        return EK_NULL_POINTER;
    }
    const ek_status status = ek_slam_init(&slam, &arena, parameters);
    *bytes = status == EK_OK ? arena.used : 0u;
    return status;
}

ek_status ek_slam_start(ek_slam *slam, void *memory, size_t bytes, const ek_slam_parameters *parameters)
{
    ek_arena arena = ek_arena_make(memory, bytes);
    if (!slam || !memory || !parameters) {
        return EK_NULL_POINTER;
    }
    const ek_status status = ek_slam_init(slam, &arena, parameters);
    return status == EK_OK ? ek_arena_check(&arena) : status;
}

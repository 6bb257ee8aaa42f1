#include "ek/frontend.h"
#include "ek/normals.h"

#include <string.h>

#define MAX_KEYFRAMES 1024u
#define MAX_POINTS ((size_t)1 << 20)
#define CELLS_PER_POINT 16u
#define MAX_CELLS ((size_t)1 << 18)

ek_frontend_parameters ek_frontend_default(void)
{
    ek_frontend_parameters parameters;
    parameters.scan_to_scan = ek_icp_default();
    parameters.scan_to_map = ek_icp_default();
    parameters.use_scan_to_scan = parameters.use_scan_to_map = 1;
    parameters.min_inliers = 10;
    parameters.keyframes = 10u;
    parameters.keyframe_distance = EK_R(0.5);
    parameters.keyframe_angle = EK_R(20.0) * EK_PI / EK_R(180.0);
    parameters.points = 2048u;
    parameters.cells = 0u;
    parameters.neighbours = 8u;
    parameters.map_voxel = EK_R(0.0);
    parameters.map_radius = EK_R(15.0);
    parameters.voxels = 16384u;
    return parameters;
}

ek_frontend_parameters ek_frontend_lines(void)
{
    ek_frontend_parameters parameters = ek_frontend_default();
    ek_icp_parameters icp = ek_icp_default();
    icp.metric = EK_METRIC_LINE;
    icp.cauchy = EK_R(0.1);
    icp.epsilon = EK_R(1e-6);
    icp.max_correspondence = EK_R(1.0);
    icp.one_to_one = 0;
    parameters.scan_to_scan = parameters.scan_to_map = icp;
    parameters.keyframe_distance = EK_R(0.3);
    parameters.keyframe_angle = EK_R(0.17453292519943295); /* 10 deg */
    parameters.map_voxel = EK_R(0.1);
    return parameters;
}

static int uses_lines(const ek_frontend_parameters *parameters)
{
    return parameters->scan_to_scan.metric == EK_METRIC_LINE || parameters->scan_to_map.metric == EK_METRIC_LINE;
}

static int is_lasting(const ek_frontend *frontend)
{
    return frontend->parameters.map_voxel > EK_R(0.0);
}

ek_status ek_frontend_check(const ek_frontend_parameters *parameters)
{
    if (!parameters) {
        return EK_NULL_POINTER;
    }
    if (!isfinite(parameters->keyframe_distance) || !isfinite(parameters->keyframe_angle)) {
        return EK_NOT_FINITE;
    }
    if (parameters->keyframe_distance < EK_R(0.0) || parameters->keyframe_angle < EK_R(0.0) ||
        parameters->keyframes < 1u || parameters->keyframes > MAX_KEYFRAMES || parameters->points < 1u ||
        parameters->points > MAX_POINTS || parameters->min_inliers < 0 || !(parameters->map_voxel >= EK_R(0.0))) {
        return EK_OUT_OF_RANGE;
    }
    if (uses_lines(parameters) && (parameters->neighbours < 2u || parameters->neighbours > EK_MAX_NEIGHBOURS)) {
        return EK_OUT_OF_RANGE;
    }
    const ek_status status = ek_icp_check(&parameters->scan_to_scan);
    return status == EK_OK ? ek_icp_check(&parameters->scan_to_map) : status;
}

static size_t cells_for(size_t points)
{
    return points < MAX_CELLS / CELLS_PER_POINT ? CELLS_PER_POINT * points : MAX_CELLS;
}

/* Memory of the last keyframes, `all` points together. */
static ek_status init_keyframes(ek_frontend *frontend, ek_arena *arena, size_t all)
{
    const ek_frontend_parameters *const p = &frontend->parameters;
    if (uses_lines(p)) {
        frontend->local_normals = (ek_real *)ek_arena_alloc(arena, all, 2u * sizeof(ek_real));
    }
    ek_status status = ek_index_init(&frontend->local_map, arena, all, p->cells ? p->cells : cells_for(all));
    status = status == EK_OK ? ek_index_updater_init(&frontend->updater, arena, all) : status;
    frontend->keyframe = (ek_real *)ek_arena_alloc(arena, 2u * p->points, sizeof(ek_real));
    frontend->keyframe_counts = (size_t *)ek_arena_alloc(arena, p->keyframes, sizeof(size_t));
    return status;
}

ek_status ek_frontend_init(ek_frontend *frontend, ek_arena *arena, const ek_frontend_parameters *parameters)
{
    if (!frontend || !arena) {
        return EK_NULL_POINTER;
    }
    ek_status status = ek_frontend_check(parameters);
    if (status != EK_OK) {
        return status;
    }
    memset(frontend, 0, sizeof *frontend);
    frontend->parameters = *parameters;
    const size_t points = parameters->points, all = points * parameters->keyframes;
    const uint32_t neighbours = uses_lines(parameters) ? parameters->neighbours : 0u;
    size_t targets = all;
    if (is_lasting(frontend)) {
        status = ek_lasting_map_init(&frontend->lasting, arena, parameters->voxels, parameters->map_voxel,
                                     parameters->map_radius, points, neighbours);
        targets = points > frontend->lasting.capacity ? points : frontend->lasting.capacity;
    } else {
        status = init_keyframes(frontend, arena, all);
    }
    status = status == EK_OK ? ek_index_init(&frontend->last, arena, points, cells_for(points)) : status;
    status = status == EK_OK ? ek_icp_init(&frontend->icp, arena, points, targets) : status;
    if (status == EK_OK && neighbours) {
        status = ek_icp_init_lines(&frontend->icp, arena);
        frontend->last_normals = (ek_real *)ek_arena_alloc(arena, points, 2u * sizeof(ek_real));
    }
    return status;
}

void ek_frontend_reset(ek_frontend *frontend)
{
    frontend->oldest_keyframe = frontend->keyframe_count = 0u;
    memset(&frontend->motion, 0, sizeof frontend->motion);
    frontend->last.count = frontend->local_map.count = 0u;
    if (is_lasting(frontend)) {
        ek_lasting_map_clear(&frontend->lasting);
    }
}

/* Check that a pose, and the points of a keyframe at it, stay within EK_MAX_COORDINATE. */
static ek_status within_reach(const ek_real *xy, size_t count, ek_pose pose, int keyframe)
{
    if (!ek_se2_is_finite(pose)) {
        return EK_NOT_FINITE;
    }
    if (EK_FABS(pose.x) > EK_MAX_COORDINATE || EK_FABS(pose.y) > EK_MAX_COORDINATE) {
        return EK_OUT_OF_RANGE;
    }
    const ek_real farther = EK_FABS(pose.x) > EK_FABS(pose.y) ? EK_FABS(pose.x) : EK_FABS(pose.y);
    const ek_real spare = EK_MAX_COORDINATE - farther - EK_R(16.0) * EK_EPSILON * EK_MAX_COORDINATE; /* rounding */
    for (size_t i = 0; keyframe && i < 2u * count; i += 2u) {
        if (!(spare > EK_R(0.0) && xy[i] * xy[i] + xy[i + 1u] * xy[i + 1u] <= spare * spare)) {
            return EK_OUT_OF_RANGE;
        }
    }
    return EK_OK;
}

/* Give an index normals that are computed when needed, if lines are to be matched. */
static ek_status defer_normals(const ek_frontend *frontend, ek_index *index, ek_real *normals)
{
    return normals ? ek_normals_defer(index, frontend->parameters.neighbours, normals) : EK_OK;
}

/* Add a scan to the map as the newest keyframe; without a lasting map, drop the oldest if there are too many. */
static ek_status add_keyframe(ek_frontend *frontend, const ek_real *xy, size_t count, ek_pose start_from_base)
{
    const uint32_t keyframes = frontend->parameters.keyframes, full = frontend->keyframe_count == keyframes;
    if (is_lasting(frontend)) {
        frontend->keyframe_count += 1u - full;
        ek_lasting_map_add(&frontend->lasting, xy, count, start_from_base);
        return EK_OK;
    }
    ek_se2_transform(start_from_base, xy, count, frontend->keyframe);
    const size_t removed = full ? frontend->keyframe_counts[frontend->oldest_keyframe] : 0u;
    frontend->keyframe_counts[(frontend->oldest_keyframe + frontend->keyframe_count) % keyframes] = count;
    frontend->oldest_keyframe = (frontend->oldest_keyframe + full) % keyframes;
    frontend->keyframe_count += 1u - full;
    const ek_status status = ek_index_update(&frontend->updater, &frontend->local_map, removed, frontend->keyframe, count);
    return status == EK_OK ? defer_normals(frontend, &frontend->local_map, frontend->local_normals) : status;
}

/* Run one stage: update *pose if the match has enough pairs, otherwise keep the guess. */
static ek_status run_stage(ek_frontend *frontend, const ek_index *target, const ek_real *xy, size_t count,
                           const ek_icp_parameters *parameters, ek_pose *guess, ek_match *match,
                           ek_stage_outcome *outcome)
{
    *outcome = EK_STAGE_GUESS_KEPT;
    if (count == 0u) {
        return EK_OK;
    }
    const ek_status status =
        ek_icp_register(&frontend->icp, target, xy, count, *guess, parameters, NULL, NULL, match);
    if (status == EK_OK && match->inliers >= frontend->parameters.min_inliers) {
        *guess = match->target_from_source;
        *outcome = EK_STAGE_ACCEPTED;
    }
    return status;
}

static ek_status check(const ek_frontend *frontend, const ek_real *xy, size_t count, const ek_prior *prior,
                       const ek_estimate *estimate)
{
    if (!frontend || !prior || !estimate || (!xy && count)) {
        return EK_NULL_POINTER;
    }
    if (count > frontend->parameters.points) {
        return EK_TOO_MANY_POINTS;
    }
    if (prior->has_odometry && !ek_se2_is_finite(prior->odom_from_base)) {
        return EK_NOT_FINITE;
    }
    for (size_t i = 0; i < 2u * count; i++) {
        if (!(EK_FABS(xy[i]) <= EK_MAX_COORDINATE)) {
            return isfinite(xy[i]) ? EK_OUT_OF_RANGE : EK_NOT_FINITE;
        }
    }
    return frontend->motion.started && prior->stamp_ns <= frontend->motion.stamp_ns ? EK_OUT_OF_RANGE : EK_OK;
}

/* Run both stages; fills *estimate except for `keyframe`. */
static ek_status run_stages(ek_frontend *frontend, const ek_real *xy, size_t count, const ek_prior *prior,
                        ek_estimate *estimate)
{
    const ek_frontend_parameters *const p = &frontend->parameters;
    ek_pose last_from_base = ek_motion_predict(&frontend->motion, prior);
    ek_status status = EK_OK;
    if (frontend->motion.started && p->use_scan_to_scan) {
        status = run_stage(frontend, &frontend->last, xy, count, &p->scan_to_scan, &last_from_base,
                          &estimate->scan_to_scan, &estimate->scan_to_scan_outcome);
    }
    if (frontend->motion.started) {
        estimate->start_from_base = ek_se2_compose(frontend->motion.start_from_points, last_from_base);
    }
    const ek_index *map = &frontend->local_map;
    if (status == EK_OK && frontend->motion.started && p->use_scan_to_map && is_lasting(frontend)) {
        map = &frontend->lasting.around;
        status = ek_lasting_map_near(&frontend->lasting, estimate->start_from_base.x, estimate->start_from_base.y);
    }
    if (status == EK_OK && frontend->motion.started && p->use_scan_to_map) {
        status = run_stage(frontend, map, xy, count, &p->scan_to_map, &estimate->start_from_base,
                          &estimate->scan_to_map, &estimate->scan_to_map_outcome);
    }
    return status;
}

/* Store the scan: as a keyframe if the base has moved enough, and as the last scan. On error nothing is changed. */
static ek_status store_scan(ek_frontend *frontend, const ek_real *xy, size_t count, const ek_prior *prior,
                      ek_estimate *estimate)
{
    const ek_pose moved = ek_se2_between(frontend->start_from_keyframe, estimate->start_from_base);
    const ek_real distance = EK_SQRT(moved.x * moved.x + moved.y * moved.y);
    estimate->keyframe =
        count && (frontend->keyframe_count == 0u || distance >= frontend->parameters.keyframe_distance ||
                  EK_FABS(moved.theta) >= frontend->parameters.keyframe_angle);
    ek_status status = within_reach(xy, count, estimate->start_from_base, estimate->keyframe);
    if (status != EK_OK) {
        return status;
    }
    if (estimate->keyframe) {
        status = add_keyframe(frontend, xy, count, estimate->start_from_base);
        frontend->start_from_keyframe = estimate->start_from_base;
    }
    if (status == EK_OK) {
        status = ek_index_build(&frontend->last, xy, count);
    }
    if (status == EK_OK) {
        status = defer_normals(frontend, &frontend->last, frontend->last_normals);
    }
    ek_motion_store(&frontend->motion, prior, estimate->start_from_base);
    estimate->start_from_base = frontend->motion.start_from_base;
    return status;
}

ek_status ek_frontend_update(ek_frontend *frontend, const ek_real *xy, size_t count, const ek_prior *prior,
                             ek_estimate *estimate)
{
    const ek_pose identity = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    const ek_match none = {identity, 0, 0, 0, (ek_real)NAN, 0u};
    ek_status status = check(frontend, xy, count, prior, estimate);
    if (status != EK_OK) {
        return status;
    }
    estimate->start_from_base = identity;
    estimate->scan_to_scan = estimate->scan_to_map = none;
    estimate->scan_to_scan_outcome = estimate->scan_to_map_outcome = EK_STAGE_SKIPPED;
    estimate->keyframe = 0;
    const ek_real centre_x = frontend->lasting.centre_x, centre_y = frontend->lasting.centre_y;
    const int32_t changed = frontend->lasting.changed;
    status = run_stages(frontend, xy, count, prior, estimate);
    status = status == EK_OK ? store_scan(frontend, xy, count, prior, estimate) : status;
    if (status != EK_OK && is_lasting(frontend)) {
        (void)ek_lasting_map_return(&frontend->lasting, centre_x, centre_y, changed); /* indexed before: no error */
    }
    return status;
}

/* The loops of slam.h: keyframes go in, judged candidates are confirmed or wait, and the map is drawn anew, in slices. */
#include "slam_parts.h"

#include <string.h>

#define STORED_VOXEL EK_R(0.03)      /* m: keyframes are kept thinned */
#define REBUILT_EVERY EK_R(5.0)      /* m: keyframes too far apart leave the map after this path */
#define CONFIRMED_WITHIN EK_R(6.0)   /* m */
#define AGREE EK_R(0.2)              /* m */
#define AGREE_THETA (EK_R(2.0) * EK_PI / EK_R(180.0))

void ek_slam_draw(ek_slam *slam, uint32_t map, const ek_real *xy, size_t count, const ek_real *sensor, ek_pose odom_from_points,
                  ek_work *work)
{
    ek_voxel_map_add(&slam->maps[map], xy, count, sensor, ek_se2_compose(ek_grid_from_odom, odom_from_points), slam->moved,
                     slam->cells, work);
    slam->map_changed |= map == slam->drawn;
}

/* Draw a keyframe into one of the two maps. */
static void draw_keyframe(ek_slam *slam, uint32_t map, size_t row, ek_pose odom_from_keyframe, ek_work *work)
{
    const ek_keyframes *const keyframes = &slam->keyframes;
    const size_t from = keyframes->start[row];
    ek_slam_draw(slam, map, keyframes->points + 2u * from, keyframes->start[row + 1u] - from, keyframes->sensor + 2u * row,
                 odom_from_keyframe, work);
}

void ek_slam_redraw(ek_slam *slam)
{
    ek_voxel_map_clear(&slam->maps[1u - slam->drawn]);
    slam->redrawn = 0u;
    slam->task = EK_TASK_REDRAW;
}

/* Draw the keyframes that belong to the map at their poses of now, the oldest first; then it replaces the old one. */
static void redraw(ek_slam *slam, ek_work *work)
{
    const ek_keyframes *const keyframes = &slam->keyframes;
    const ek_pose *const pose = keyframes->graph.pose;
    const ek_real reach = EK_R(2.0) * slam->parameters.map_radius;
    for (; slam->redrawn < keyframes->count && work->left > 0; slam->redrawn++) {
        const size_t k = slam->redrawn, last = keyframes->count - 1u;
        const ek_real x = pose[k].x - pose[last].x, y = pose[k].y - pose[last].y;
        ek_work_spend(work, 1u);
        if (x * x + y * y <= reach * reach && keyframes->apart[k] <= slam->parameters.map_reach) {
            draw_keyframe(slam, 1u - slam->drawn, k, ek_se2_compose(slam->next_odom_from_start, pose[k]), work);
        }
    }
    if (slam->redrawn == keyframes->count) {
        slam->drawn = 1u - slam->drawn;
        slam->map_changed = 1;
        slam->odom_from_start = slam->next_odom_from_start;
        slam->built_at = keyframes->path[keyframes->count - 1u];
        slam->task = EK_TASK_IDLE;
    }
}

static ek_loop_record *record(ek_slam *slam, const ek_loop_candidate *candidate)
{
    if (slam->record_count == slam->parameters.records) {
        slam->unrecorded++;
        return NULL;
    }
    ek_loop_record *const now = slam->record + slam->record_count++;
    memset(now, 0, sizeof *now);
    now->candidate = *candidate;
    now->section = slam->keyframes.section[candidate->edge.second];
    return now;
}

/* 1 if two candidates measure the same place. */
static int agree(const ek_slam *slam, const ek_loop_edge *first, const ek_loop_edge *second)
{
    const ek_keyframes *const keyframes = &slam->keyframes;
    const ek_pose *const pose = keyframes->graph.pose;
    if (keyframes->path[second->second] - keyframes->path[first->second] > CONFIRMED_WITHIN) {
        return 0;
    }
    const ek_pose driven = ek_se2_between(pose[first->second], pose[second->second]);
    const ek_pose one = ek_se2_compose(ek_se2_compose(pose[first->first], first->first_from_second), driven);
    const ek_pose two = ek_se2_compose(pose[second->first], second->first_from_second);
    const ek_pose gap = ek_se2_between(one, two);
    return gap.x * gap.x + gap.y * gap.y <= AGREE * AGREE && EK_FABS(gap.theta) <= AGREE_THETA;
}

static int is_confirmed(const ek_slam *slam, const ek_loop_candidate *candidate)
{
    int confirmed = candidate->is_local && candidate->chi <= slam->parameters.loop.quick_gate;
    for (uint32_t k = 0; k < slam->waiting_count; k++) {
        confirmed |= agree(slam, &slam->waiting[k].edge, &candidate->edge);
    }
    return confirmed;
}

static void wait_for_another(ek_slam *slam, const ek_loop_candidate *candidate)
{
    if (slam->waiting_count == 4u) {
        memmove(slam->waiting, slam->waiting + 1, 3u * sizeof *slam->waiting);
        slam->waiting_count = 3u;
    }
    slam->waiting[slam->waiting_count++] = *candidate;
}

/* Record the judged candidate and, where it closes a loop, begin to optimise. */
static void consider(ek_slam *slam, ek_work *work)
{
    const ek_loop_candidate candidate = slam->finder.candidate;
    ek_keyframes *const keyframes = &slam->keyframes;
    const int passed = candidate.outcome == EK_LOOP_PASSED, confirmed = passed && is_confirmed(slam, &candidate);
    const size_t loops = keyframes->graph.loop_count;
    ek_loop_record *const now = record(slam, &candidate);
    slam->task = EK_TASK_IDLE;
    if (!confirmed || !now || loops == slam->parameters.loops) {
        if (now) {
            now->unconfirmed = passed && !confirmed;
            now->no_room = confirmed;
        }
        if (passed && !confirmed) {
            wait_for_another(slam, &candidate);
        }
        return;
    }
    slam->waiting_count = 0u;
    now->found_again = keyframes->apart[candidate.edge.first] >= EK_DOUBTED;
    if (now->found_again) {
        ek_keyframes_join(keyframes, &candidate.edge, !candidate.known, work);
    }
    now->accepted = ek_pose_graph_close(&keyframes->graph, &candidate.edge) == EK_OK;
    if (now->accepted) {
        slam->record_of_loop[loops] = (uint32_t)(slam->record_count - 1u);
        ek_slam_solve(slam);
    }
}

void ek_slam_work(ek_slam *slam, ek_work *work)
{
    while (slam->task != EK_TASK_IDLE && work->left > 0) {
        if (slam->task == EK_TASK_REDRAW) {
            redraw(slam, work);
        } else if (slam->task == EK_TASK_FIND) {
            if (ek_loop_finder_work(&slam->finder, &slam->keyframes, work)) {
                consider(slam, work);
            }
        } else if (ek_pose_graph_work(&slam->keyframes.graph, work)) {
            ek_slam_next_run(slam, work);
            ek_work_spend(work, 4u * (uint64_t)slam->parameters.loops);
        }
    }
}

/* A lost track: the map begins anew with this keyframe. */
static void begin_anew(ek_slam *slam, ek_work *work)
{
    const size_t last = slam->keyframes.count - 1u;
    slam->waiting_count = 0u;
    if (slam->task == EK_TASK_FIND || slam->task == EK_TASK_REDRAW) {
        slam->finder.phase = EK_FINDER_IDLE;
        slam->task = EK_TASK_IDLE;
    }
    slam->odom_from_start = ek_slam_odom_from_start(slam);
    slam->built_at = slam->keyframes.path[last];
    ek_voxel_map_clear(&slam->maps[slam->drawn]);
    draw_keyframe(slam, slam->drawn, last, slam->odom_from_keyframe[last], work);
}

/* The last unconfirmed candidate, where another one may still confirm it; NULL: there is none. */
static const ek_loop_candidate *expected_candidate(const ek_slam *slam)
{
    const ek_loop_candidate *const newest = slam->waiting_count ? slam->waiting + slam->waiting_count - 1u : NULL;
    const ek_real *const path = slam->keyframes.path;
    const int in_reach = newest && path[slam->keyframes.count - 1u] - path[newest->edge.second] <= CONFIRMED_WITHIN;
    return in_reach ? newest : NULL;
}

ek_status ek_slam_insert(ek_slam *slam, ek_pose odom_from_base, ek_step_kind kind, ek_pose graph_pose, ek_work *work)
{
    ek_keyframes *const keyframes = &slam->keyframes;
    const ek_pose identity = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    const size_t row = keyframes->count;
    const size_t count = ek_thin(&slam->thinner, slam->scan.hits, slam->scan.count, STORED_VOXEL, slam->stored, work);
    ek_observer_take(&slam->observer, &slam->thinner, slam->stored, count, work);
    const ek_openness open = ek_observer_measure(&slam->observer, slam->parameters.map_radius);
    const ek_real sensor[2] = {slam->parameters.scan.base_from_sensor.x, slam->parameters.scan.base_from_sensor.y};
    const ek_pose step = row ? ek_se2_between(slam->odom_from_keyframe[row - 1u], graph_pose) : identity;
    slam->in_room = ek_openness_is_room(&open);
    ek_slam_observe_wheels(slam, step, &open, kind == EK_STEP_MATCHED);
    ek_status status = ek_keyframes_add(keyframes, slam->stored, count, sensor, step, kind, &open, slam->doubt, work);
    if (status != EK_OK) { /* no room: from now on an odometry on the lasting map */
        slam->full = 1;
        ek_slam_draw(slam, slam->drawn, slam->stored, count, sensor, odom_from_base, work);
        return status == EK_TOO_MANY_POINTS ? EK_OK : status;
    }
    slam->odom_from_keyframe[row] = odom_from_base;
    slam->doubt.position = slam->doubt.heading = EK_R(0.0);
    if (kind != EK_STEP_MATCHED) {
        begin_anew(slam, work);
        return EK_OK;
    }
    ek_slam_draw(slam, slam->drawn, slam->stored, count, sensor, odom_from_base, work);
    if (!slam->full && slam->task == EK_TASK_IDLE &&
        ek_loop_finder_begin(&slam->finder, keyframes, expected_candidate(slam), slam->wheels.has_last, work)) {
        slam->task = EK_TASK_FIND;
        ek_slam_work(slam, work);
    }
    if (slam->task == EK_TASK_IDLE && keyframes->path[row] - slam->built_at >= REBUILT_EVERY) {
        slam->next_odom_from_start = slam->odom_from_start;
        ek_slam_redraw(slam);
    }
    return EK_OK;
}

ek_pose ek_slam_correct(const ek_slam *slam, uint32_t keyframe, ek_pose odom_from_base)
{
    const ek_pose *const odom = slam->odom_from_keyframe, *const pose = slam->keyframes.graph.pose;
    if (keyframe >= slam->keyframes.count) {
        return ek_se2_compose(ek_se2_inverse(slam->odom_from_start), odom_from_base);
    }
    const ek_pose since = ek_se2_between(odom[keyframe], odom_from_base);
    const ek_pose corrected = ek_se2_compose(pose[keyframe], since);
    if (keyframe + 1u == slam->keyframes.count) {
        return corrected;
    }
    const ek_pose step = ek_se2_between(odom[keyframe], odom[keyframe + 1u]);
    const ek_pose missing = ek_se2_between(ek_se2_compose(pose[keyframe], step), pose[keyframe + 1u]);
    const ek_real whole = EK_SQRT(step.x * step.x + step.y * step.y) + EK_FABS(step.theta);
    const ek_real part = EK_SQRT(since.x * since.x + since.y * since.y) + EK_FABS(since.theta);
    const ek_real share = part / (whole > EK_R(1e-9) ? whole : EK_R(1e-9));
    const ek_real most = share < EK_R(1.0) ? share : EK_R(1.0);
    const ek_pose correction = {most * missing.x, most * missing.y, most * missing.theta};
    return ek_se2_compose(corrected, correction);
}

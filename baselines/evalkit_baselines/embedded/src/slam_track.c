/* How slam.h follows the robot: what a scan is matched with, the scan before and the part of the map around it, and the stages
 * of its matches. */
#include "slam_parts.h"
#include "ek/normals.h"

#include <string.h>

#define NEIGHBOURS 8u
#define RECENTRE EK_R(0.1)      /* share of the map's radius that the robot moves before its part is taken again */
#define AS_MANY EK_R(0.02)      /* share by which a scan near a keyframe in a room may have more or fewer points */

/* Index a cloud; its normals are computed when a match needs them. */
static ek_status index_lines(ek_index *index, ek_real *normals, const ek_real *xy, size_t count)
{
    const ek_status status = ek_index_build(index, xy, count);
    return status == EK_OK ? ek_normals_defer(index, NEIGHBOURS, normals) : status;
}

void ek_slam_keep_last(ek_slam *slam, ek_pose odom_from_base)
{
    memcpy(slam->last_points, slam->scan.hits, 2u * slam->scan.count * sizeof(ek_real));
    slam->last_count = slam->scan.count;
    slam->last_outdated = !slam->last_compared;
    slam->last_indexed = slam->last_compared = 0;
    slam->last_odom_from_base = odom_from_base;
    slam->last_base_from_sensor = slam->parameters.scan.base_from_sensor;
}

static ek_status index_last(ek_slam *slam, size_t count)
{
    const ek_status status = index_lines(&slam->last, slam->last_normals, slam->last_points, count);
    slam->last_indexed = status == EK_OK;
    return status;
}

ek_status ek_slam_forget_last(ek_slam *slam)
{
    return index_last(slam, 0u);
}

ek_status ek_slam_take_map(ek_slam *slam, ek_pose near, ek_work *work)
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

int ek_slam_is_measured(const ek_slam *slam, const ek_prior *prior)
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

int ek_slam_is_keyframe(const ek_slam *slam, ek_pose odom_from_base)
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
    return slam->in_room && EK_FABS(count - before) <= AS_MANY * before && !ek_slam_is_keyframe(slam, predicted);
}

ek_status ek_slam_track(ek_slam *slam, const ek_prior *prior, ek_slam_estimate *estimate, ek_work *work)
{
    ek_pose last_from_base = ek_motion_predict(&slam->motion, prior), pose = estimate->odom_from_base;
    if (!slam->motion.started) {
        return EK_OK;
    }
    slam->tried = 0;
    slam->matching = 0u;
    const int measured = ek_slam_is_measured(slam, prior);
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
        status = ek_slam_take_map(slam, predicted, work);
        if (status == EK_OK && ek_slam_match_directly(slam, &estimate->odom_from_base, &estimate->scan_to_map)) {
            estimate->has_scan_to_map = estimate->scan_to_map_accepted = 1;
            return EK_OK;
        }
    }
    if (status == EK_OK && !slam->last_indexed) {
        status = index_last(slam, slam->last_count);
    }
    if (status == EK_OK) {
        status = run_stage(slam, &slam->last, NULL, &last_from_base, &estimate->scan_to_scan,
                           &estimate->scan_to_scan_accepted);
    }
    pose = ek_se2_compose(slam->motion.start_from_points, last_from_base);
    if (status == EK_OK) {
        status = ek_slam_take_map(slam, pose, work);
    }
    if (status == EK_OK) {
        status = run_stage(slam, &slam->map_index, measured ? NULL : &predicted, &pose, &estimate->scan_to_map,
                           &estimate->scan_to_map_accepted);
    }
    estimate->has_scan_to_scan = estimate->has_scan_to_map = 1;
    estimate->odom_from_base = pose;
    return status;
}

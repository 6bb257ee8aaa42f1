/* The parameters of slam.h, and its memory. */
#include "slam_parts.h"

#include <string.h>

#define CELLS_PER_POINT 16u
#define MAX_CELLS ((size_t)1 << 18)
#define MAX_VOXEL_POINTS 200u

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

#include "ek/continuity.h"

#include <string.h>

#define NEAR EK_R(0.25) /* m: a point within it lies on the scan before; as in the reference, like the others */
#define MIN_SHARE EK_R(0.7)
#define MIN_POINTS 20u
#define VOXEL EK_R(0.1)
#define GAP (EK_R(5.0) * EK_PI / EK_R(180.0))
#define BEHIND EK_R(0.5) /* m */
#define SAMPLES 200u   /* points that are asked: every n-th, so that so many are left, and less than twice as many */
#define POINT_WORK 50u /* operations: sort, search of a ray, share of the index */
#define CELLS_PER_POINT 16u
#define MAX_CELLS ((size_t)1 << 16)

ek_status ek_continuity_init(ek_continuity *continuity, ek_arena *arena, size_t capacity)
{
    if (!continuity || !arena) {
        return EK_NULL_POINTER;
    }
    memset(continuity, 0, sizeof *continuity);
    const size_t cells = capacity < MAX_CELLS / CELLS_PER_POINT ? CELLS_PER_POINT * capacity : MAX_CELLS;
    const ek_status status = ek_index_init(&continuity->before, arena, capacity, cells);
    continuity->ray = (ek_view_ray *)ek_arena_alloc(arena, capacity, sizeof(ek_view_ray));
    continuity->other = (ek_view_ray *)ek_arena_alloc(arena, capacity, sizeof(ek_view_ray));
    continuity->moved = (ek_real *)ek_arena_alloc(arena, capacity, 2u * sizeof(ek_real));
    continuity->seen = (uint32_t *)ek_arena_alloc(arena, capacity, sizeof(uint32_t));
    return status;
}

/* Sort the rays by bearing: merge runs of doubling length; stable. */
static void sort_rays(ek_continuity *continuity)
{
    const size_t count = continuity->rays;
    for (size_t width = 1u; width < count; width *= 2u) {
        const ek_view_ray *const from = continuity->ray;
        ek_view_ray *const to = continuity->other;
        for (size_t start = 0u; start < count; start += 2u * width) {
            const size_t middle = start + width < count ? start + width : count;
            const size_t end = middle + width < count ? middle + width : count;
            size_t i = start, j = middle;
            for (size_t k = start; k < end; k++) {
                const int left = i < middle && (j >= end || from[i].bearing <= from[j].bearing);
                to[k] = left ? from[i++] : from[j++];
            }
        }
        continuity->other = continuity->ray;
        continuity->ray = to;
    }
}

/* The ray next to a bearing, and how far it is from it (rad). */
static ek_view_ray nearest_ray(const ek_continuity *continuity, ek_real bearing, ek_real *gap)
{
    const ek_view_ray *const ray = continuity->ray;
    const size_t count = continuity->rays;
    size_t low = 0u, high = count; /* the first ray that is not before the bearing */
    while (low < high) {
        const size_t middle = (low + high) / 2u;
        if (ray[middle].bearing < bearing) {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    const ek_real turn = EK_R(2.0) * EK_PI;
    const ek_view_ray left = low > 0u ? ray[low - 1u] : ray[count - 1u], right = low < count ? ray[low] : ray[0];
    const ek_real before = bearing - (low > 0u ? left.bearing : left.bearing - turn);
    const ek_real after = (low < count ? right.bearing : right.bearing + turn) - bearing;
    *gap = before < after ? before : after;
    return before < after ? left : right;
}

/* Select of every n-th point those that the scan before could see; returns their number. */
static size_t select_seen(ek_continuity *continuity, size_t count, uint32_t every)
{
    const ek_pose sensor = continuity->sensor;
    const ek_real c = EK_COS(sensor.theta), s = EK_SIN(sensor.theta);
    size_t seen = 0u;
    for (uint32_t i = 0; i < count; i += every) {
        const ek_real *const point = continuity->moved + 2u * (size_t)i, dx = point[0] - sensor.x, dy = point[1] - sensor.y;
        const ek_real x = c * dx + s * dy, y = c * dy - s * dx;
        ek_real gap;
        const ek_view_ray ray = nearest_ray(continuity, EK_ATAN2(y, x), &gap);
        const ek_real range = EK_SQRT(x * x + y * y);
        continuity->seen[seen] = i;
        seen += gap <= GAP && range <= ray.range + BEHIND;
    }
    return seen;
}

/* Whether enough of the selected points lie on the scan before, or on the map if there is one. */
static int enough_lie_on(const ek_continuity *continuity, size_t seen, const ek_index *map)
{
    size_t on = 0u;
    for (size_t k = 0; k < seen && (ek_real)on / (ek_real)seen < MIN_SHARE; k++) {
        const ek_real *const point = continuity->moved + 2u * (size_t)continuity->seen[k];
        on += ek_index_nearest(&continuity->before, point[0], point[1], NEAR, NEAR).slot != EK_NONE ||
              (map && ek_index_nearest(map, point[0], point[1], NEAR, NEAR).slot != EK_NONE);
    }
    return (ek_real)on / (ek_real)seen >= MIN_SHARE;
}

void ek_continuity_keep(ek_continuity *continuity, ek_thinner *thinner, const ek_real *xy, size_t count,
                        ek_pose odom_from_base, ek_pose base_from_sensor, ek_work *work)
{
    ek_real *const moved = continuity->moved;
    const size_t cells = ek_thin(thinner, xy, count, VOXEL, moved, work);
    if (cells < MIN_POINTS) {
        return;
    }
    continuity->sensor = ek_se2_compose(odom_from_base, base_from_sensor);
    ek_se2_transform(odom_from_base, moved, cells, moved);
    ek_index_build(&continuity->before, moved, cells);
    ek_se2_transform(ek_se2_inverse(continuity->sensor), moved, cells, moved);
    for (size_t i = 0; i < cells; i++) {
        const ek_real x = moved[2u * i], y = moved[2u * i + 1u];
        continuity->ray[i].bearing = EK_ATAN2(y, x);
        continuity->ray[i].range = EK_SQRT(x * x + y * y);
    }
    continuity->rays = cells;
    sort_rays(continuity);
    ek_work_spend(work, POINT_WORK * (uint64_t)cells);
}

int ek_continuity_is_lost(ek_continuity *continuity, ek_thinner *thinner, const ek_real *xy, size_t count,
                          ek_pose odom_from_base, int is_predicted, const ek_index *map, ek_work *work)
{
    const size_t cells = ek_thin(thinner, xy, count, VOXEL, continuity->moved, work);
    const uint32_t every = cells / SAMPLES > 1u ? (uint32_t)(cells / SAMPLES) : 1u;
    if (cells < MIN_POINTS || continuity->before.count == 0u) {
        return 0;
    }
    ek_se2_transform(odom_from_base, continuity->moved, cells, continuity->moved);
    ek_work_spend(work, POINT_WORK * (uint64_t)cells);
    const size_t seen = select_seen(continuity, cells, every);
    if (seen * every < MIN_POINTS) {
        return !is_predicted;
    }
    return !enough_lie_on(continuity, seen, NULL) && !(is_predicted && enough_lie_on(continuity, seen, map));
}

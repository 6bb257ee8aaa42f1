#include "ek/continuity.h"

#include <string.h>

#define NEAR EK_R(0.25) /* m: a point within it lies on the scan before; as in the reference, like the others */
#define MIN_SHARE EK_R(0.7)
#define MIN_POINTS 20u
#define VOXEL EK_R(0.1)
#define BEHIND EK_R(0.5) /* m */
#define SAMPLES 200u   /* points that are asked: every n-th, so that so many are left, and less than twice as many */
#define POINT_WORK EK_SIGHT_WORK /* with the share of the index */
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
    continuity->sight.ray = (ek_sight_ray *)ek_arena_alloc(arena, capacity, sizeof(ek_sight_ray));
    continuity->sight.other = (ek_sight_ray *)ek_arena_alloc(arena, capacity, sizeof(ek_sight_ray));
    continuity->moved = (ek_real *)ek_arena_alloc(arena, capacity, 2u * sizeof(ek_real));
    continuity->seen = (uint32_t *)ek_arena_alloc(arena, capacity, sizeof(uint32_t));
    return status;
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
        continuity->seen[seen] = i;
        seen += ek_sight_could_see(&continuity->sight, x, y, BEHIND) != 0;
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
    ek_sight_take(&continuity->sight, moved, cells, EK_R(0.0), EK_R(0.0));
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

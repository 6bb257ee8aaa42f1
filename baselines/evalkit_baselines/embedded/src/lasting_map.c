#include "ek/lasting_map.h"
#include "ek/normals.h"

#include <string.h>

#define CELLS_PER_POINT 16u
#define MAX_CELLS ((size_t)1 << 18)
#define RECENTRE EK_R(0.1) /* share of the radius */

/* The largest number of voxels within the radius: those of the square around it. */
static size_t count_around(size_t voxels, ek_real voxel, ek_real radius)
{
    const ek_real half = radius / voxel + EK_R(2.0), most = EK_R(4.0) * half * half;
    return most < (ek_real)voxels ? (size_t)most : voxels;
}

ek_status ek_lasting_map_init(ek_lasting_map *map, ek_arena *arena, size_t voxels, ek_real voxel, ek_real radius,
                              size_t points, uint32_t neighbours)
{
    if (!map || !arena) {
        return EK_NULL_POINTER;
    }
    if (!(radius > EK_R(0.0) && radius <= EK_MAX_COORDINATE)) {
        return EK_OUT_OF_RANGE;
    }
    memset(map, 0, sizeof *map);
    ek_status status = ek_voxel_map_init(&map->voxels, arena, voxels, voxel, EK_VOXEL_POINTS);
    if (status != EK_OK) {
        return status;
    }
    map->radius = radius;
    map->neighbours = neighbours;
    map->changed = 1;
    map->capacity = count_around(voxels, voxel, radius);
    const size_t cells = map->capacity < MAX_CELLS / CELLS_PER_POINT ? CELLS_PER_POINT * map->capacity : MAX_CELLS;
    status = ek_index_init(&map->around, arena, map->capacity, cells);
    map->means = (ek_real *)ek_arena_alloc(arena, map->capacity, 2u * sizeof(ek_real));
    if (neighbours) {
        map->support = (uint32_t *)ek_arena_alloc(arena, map->capacity, sizeof(uint32_t));
        map->normals = (ek_real *)ek_arena_alloc(arena, map->capacity, 2u * sizeof(ek_real));
    }
    map->moved = (ek_real *)ek_arena_alloc(arena, points, 2u * sizeof(ek_real));
    map->cells = (int32_t *)ek_arena_alloc(arena, points, 2u * sizeof(int32_t));
    return status;
}

void ek_lasting_map_clear(ek_lasting_map *map)
{
    ek_voxel_map_clear(&map->voxels);
    map->voxels.dropped = 0u;
    map->around.count = 0u;
    map->centre_x = map->centre_y = EK_R(0.0);
    map->changed = 1;
}

void ek_lasting_map_add(ek_lasting_map *map, const ek_real *xy, size_t count, ek_pose start_from_base)
{
    ek_work work = ek_work_make(INT64_MAX);
    ek_voxel_map_add(&map->voxels, xy, count, NULL, start_from_base, map->moved, map->cells, &work);
    map->changed = 1;
}

/* Index the voxels around a centre. */
static ek_status take_around(ek_lasting_map *map, ek_real x, ek_real y)
{
    ek_work work = ek_work_make(INT64_MAX);
    const size_t count = ek_voxel_map_cloud(&map->voxels, x, y, map->radius, map->means, map->support, NULL,
                                            map->capacity, &work);
    map->centre_x = x;
    map->centre_y = y;
    map->changed = 0;
    const ek_status status = ek_index_build(&map->around, map->means, count);
    map->around.support = map->support;
    return status == EK_OK && map->neighbours ? ek_normals_defer(&map->around, map->neighbours, map->normals) : status;
}

ek_status ek_lasting_map_near(ek_lasting_map *map, ek_real x, ek_real y)
{
    const ek_real dx = x - map->centre_x, dy = y - map->centre_y, far = RECENTRE * map->radius;
    return map->changed || dx * dx + dy * dy > far * far ? take_around(map, x, y) : EK_OK;
}

ek_status ek_lasting_map_return(ek_lasting_map *map, ek_real centre_x, ek_real centre_y, int32_t changed)
{
    const int moved = map->centre_x != centre_x || map->centre_y != centre_y;
    const ek_status status = moved && !changed ? take_around(map, centre_x, centre_y) : EK_OK;
    map->centre_x = centre_x;
    map->centre_y = centre_y;
    map->changed = changed;
    return status;
}

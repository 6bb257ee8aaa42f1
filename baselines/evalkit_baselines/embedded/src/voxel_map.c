#include "ek/voxel_map.h"
#include "ek/tally.h"

#include <string.h>

#define MAX_VOXELS ((size_t)1 << 26)

ek_status ek_voxel_map_init(ek_voxel_map *map, ek_arena *arena, size_t capacity, ek_real size, uint32_t max_points)
{
    size_t entries = 16u;
    if (!map || !arena) {
        return EK_NULL_POINTER;
    }
    if (capacity == 0u || capacity > MAX_VOXELS || !(size >= EK_R(0.01) && size <= EK_R(100.0)) || max_points == 0u) {
        return EK_OUT_OF_RANGE;
    }
    while (entries < 2u * capacity) {
        entries *= 2u;
    }
    memset(map, 0, sizeof *map);
    map->capacity = capacity;
    map->mask = entries - 1u;
    map->size = size;
    map->max_points = max_points;
    map->voxel = (ek_voxel *)ek_arena_alloc(arena, capacity, sizeof(ek_voxel));
    map->entry = (uint32_t *)ek_arena_alloc(arena, entries, sizeof(uint32_t));
    if (arena->memory && ek_arena_check(arena) == EK_OK) {
        memset(map->entry, 0, entries * sizeof(uint32_t));
    }
    return EK_OK;
}

ek_status ek_voxel_map_keep_views(ek_voxel_map *map, ek_arena *arena)
{
    if (!map || !arena) {
        return EK_NULL_POINTER;
    }
    map->seen_from = (ek_real *)ek_arena_alloc(arena, map->capacity, 2u * sizeof(ek_real));
    return EK_OK;
}

void ek_voxel_map_clear(ek_voxel_map *map)
{
    map->count = 0u;
    EK_COUNT(EK_CELLS, map->mask + 1u);
    memset(map->entry, 0, (map->mask + 1u) * sizeof *map->entry);
}

/* Entry of a voxel in the hash table, or the free entry where it belongs. */
static size_t find_entry(const ek_voxel_map *map, int32_t column, int32_t row)
{
    uint32_t hash = (uint32_t)column * 0x9E3779B1u ^ (uint32_t)row * 0x85EBCA77u;
    hash ^= hash >> 15;
    size_t at = hash & map->mask;
    EK_COUNT(EK_PROBES, 1u);
    while (map->entry[at]) {
        const ek_voxel *const voxel = map->voxel + map->entry[at] - 1u;
        if (voxel->column == column && voxel->row == row) {
            break;
        }
        at = (at + 1u) & map->mask;
        EK_COUNT(EK_PROBES, 1u);
    }
    return at;
}

/* Sums over points: their number, their places (m), and unit vectors to where they were seen from. */
typedef struct {
    uint32_t points;
    ek_real x, y, toward_x, toward_y;
} sums;

/* Add the sums of some points of the present cloud to the voxel of a cell. */
static void add_to_voxel(ek_voxel_map *map, const int32_t *cell, const sums *of)
{
    const size_t at = find_entry(map, cell[0], cell[1]);
    if (!map->entry[at]) {
        if (map->count == map->capacity) {
            map->dropped++;
            return;
        }
        const ek_voxel fresh = {cell[0], cell[1], 0u, map->cloud, EK_R(0.0), EK_R(0.0)};
        if (map->seen_from) {
            map->seen_from[2u * map->count] = map->seen_from[2u * map->count + 1u] = EK_R(0.0);
        }
        map->voxel[map->count++] = fresh;
        map->entry[at] = (uint32_t)map->count;
    }
    ek_voxel *const voxel = map->voxel + map->entry[at] - 1u;
    if (voxel->points < map->max_points || voxel->cloud == map->cloud) {
        voxel->cloud = map->cloud;
        voxel->points += of->points;
        voxel->x += of->x;
        voxel->y += of->y;
        if (map->seen_from) {
            ek_real *const toward = map->seen_from + 2u * (size_t)(voxel - map->voxel);
            toward[0] += of->toward_x;
            toward[1] += of->toward_y;
        }
    }
}

static void number_cells(const ek_real *EK_RESTRICT coordinates, size_t count, ek_real size, int32_t *EK_RESTRICT cells)
{
    for (size_t k = 0; k < count; k++) {
        cells[k] = ek_floor(coordinates[k] / size);
    }
}

/* Add the unit vector from a point to the sensor; none for a point there. */
static void add_view(const ek_real *point, const ek_real *sensor, sums *to)
{
    const ek_real x = sensor[0] - point[0], y = sensor[1] - point[1], away = EK_SQRT(x * x + y * y);
    const ek_real share = away > EK_R(0.0) ? EK_R(1.0) / away : EK_R(0.0);
    to->toward_x += share * x;
    to->toward_y += share * y;
}

void ek_voxel_map_add(ek_voxel_map *map, const ek_real *xy, size_t count, const ek_real *sensor, ek_pose map_from_points,
                      ek_real *moved, int32_t *cells, ek_work *work)
{
    ek_real seen_from[2] = {EK_R(0.0), EK_R(0.0)};
    if (map->seen_from) {
        ek_se2_transform(map_from_points, sensor, 1u, seen_from);
    }
    ek_se2_transform(map_from_points, xy, count, moved);
    number_cells(moved, 2u * count, map->size, cells);
    EK_COUNT(EK_ADDED, map->seen_from ? 2u * count : count);
    map->cloud++;
    for (size_t first = 0, next; first < count; first = next) { /* neighbouring beams often end in one voxel */
        const int32_t *const cell = cells + 2u * first;
        sums sum = {0u, EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(0.0)};
        for (next = first; next < count && cells[2u * next] == cell[0] && cells[2u * next + 1u] == cell[1]; next++) {
            sum.points++;
            sum.x += moved[2u * next];
            sum.y += moved[2u * next + 1u];
            if (map->seen_from) {
                add_view(moved + 2u * next, seen_from, &sum);
            }
        }
        add_to_voxel(map, cell, &sum);
    }
    ek_work_spend_tallied(work, (map->seen_from ? 8u : 6u) * (uint64_t)count);
}

size_t ek_voxel_map_cloud(const ek_voxel_map *map, ek_real x, ek_real y, ek_real radius, ek_real *means, uint32_t *points,
                          ek_real *seen_from, size_t capacity, ek_work *work)
{
    size_t count = 0u;
    EK_COUNT(EK_VOXELS, seen_from ? 2u * map->count : map->count);
    for (size_t k = 0; k < map->count && count < capacity; k++) {
        const ek_voxel *const voxel = map->voxel + k;
        const ek_real number = (ek_real)voxel->points, u = voxel->x / number, v = voxel->y / number;
        if (points) {
            points[count] = voxel->points;
        }
        if (seen_from && map->seen_from) {
            seen_from[2u * count] = map->seen_from[2u * k] / number;
            seen_from[2u * count + 1u] = map->seen_from[2u * k + 1u] / number;
        }
        means[2u * count] = u;
        means[2u * count + 1u] = v;
        count += (u - x) * (u - x) + (v - y) * (v - y) <= radius * radius;
    }
    ek_work_spend_tallied(work, map->count);
    return count;
}


/* voxel_map.h - one lasting map: a mean for each square voxel, with room for a fixed number of voxels.
 *
 * Computes the same as VoxelMap in evalkit/odometry/local_map.py: a voxel takes no more points once it has max_points, so
 * that later visits, which drift, do not move the map.
 */
#ifndef EK_VOXEL_MAP_H
#define EK_VOXEL_MAP_H

#include "ek/arena.h"
#include "ek/se2.h"
#include "ek/work.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    int32_t column, row;
    uint32_t points, cloud; /* cloud: the last one that it took points of */
    ek_real x, y;           /* sums (m) */
} ek_voxel;

typedef struct {
    size_t capacity, count; /* voxels */
    size_t mask;            /* entries of the hash table - 1 */
    ek_real size;           /* m */
    uint32_t max_points, cloud;
    ek_voxel *voxel;        /* in the order of their first points */
    ek_real *seen_from;     /* NULL, or for each voxel the sum of unit vectors x y from its points to the sensor */
    uint32_t *entry;        /* hash table: 1 + voxel, 0: free */
    uint64_t dropped;       /* times that points of a new cell had no room */
} ek_voxel_map;

#define ek_voxel_map_init EK_NAME(voxel_map_init)
#define ek_voxel_map_keep_views EK_NAME(voxel_map_keep_views)
#define ek_voxel_map_clear EK_NAME(voxel_map_clear)
#define ek_voxel_map_add EK_NAME(voxel_map_add)
#define ek_voxel_map_cloud EK_NAME(voxel_map_cloud)

/* Initialise an empty map in an arena (or measure it). EK_OUT_OF_RANGE: capacity 0 or above 2^26, a voxel below 0.01 m or
 * above 100 m, max_points 0. */
ek_status ek_voxel_map_init(ek_voxel_map *map, ek_arena *arena, size_t capacity, ek_real size, uint32_t max_points);

/* Let an empty map keep from where its points are seen (memory in addition). */
ek_status ek_voxel_map_keep_views(ek_voxel_map *map, ek_arena *arena);

/* Remove all voxels. */
void ek_voxel_map_clear(ek_voxel_map *map);

/* Add points at a pose: count pairs x y (m), which stay within EK_MAX_COORDINATE; `moved` and `cells` are working memory for as
 * many pairs. `sensor`: where they were seen from, x y in their frame (m); NULL for a map that does not keep that. A voxel takes
 * all points of a cloud or none. 6 operations a point, 2 more where it is kept. */
void ek_voxel_map_add(ek_voxel_map *map, const ek_real *xy, size_t count, const ek_real *sensor, ek_pose map_from_points,
                      ek_real *moved, int32_t *cells, ek_work *work);

/* Write the means within a radius (m) of a place, at most `capacity` pairs, the number of points of each (`points`; NULL:
 * not wanted), and the mean of the unit vectors to where they were seen from (`seen_from`, pairs x y; NULL: not wanted, or not
 * kept); returns the number of means. 1 operation a voxel. */
size_t ek_voxel_map_cloud(const ek_voxel_map *map, ek_real x, ek_real y, ek_real radius, ek_real *means, uint32_t *points,
                          ek_real *seen_from, size_t capacity, ek_work *work);

#ifdef __cplusplus
}
#endif
#endif

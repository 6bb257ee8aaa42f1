/* lasting_map.h - one map of all keyframes to match with: voxels, and an index of those around the robot.
 *
 * Computes the same as VoxelMap in evalkit/odometry/local_map.py. The part around the robot is taken again when the map
 * has changed, or when the robot is a tenth of the radius away from where it was taken.
 */
#ifndef EK_LASTING_MAP_H
#define EK_LASTING_MAP_H

#include "ek/index.h"
#include "ek/voxel_map.h"

#ifdef __cplusplus
extern "C" {
#endif

#define EK_VOXEL_POINTS 20u /* a voxel with so many points takes no more */

typedef struct {
    ek_voxel_map voxels; /* voxels.dropped: times that points of a new cell had no room */
    ek_index around;     /* the means of the voxels around the centre */
    size_t capacity;     /* points of `around` */
    ek_real radius;      /* m */
    ek_real centre_x, centre_y; /* m */
    int32_t changed;     /* 1: take the part around the robot again */
    uint32_t neighbours; /* that define a normal; 0: no normals */
    ek_real *means, *normals, *moved;
    int32_t *cells;
    uint32_t *support;   /* points of each mean, for lines */
} ek_lasting_map;

#define ek_lasting_map_init EK_NAME(lasting_map_init)
#define ek_lasting_map_clear EK_NAME(lasting_map_clear)
#define ek_lasting_map_add EK_NAME(lasting_map_add)
#define ek_lasting_map_near EK_NAME(lasting_map_near)
#define ek_lasting_map_return EK_NAME(lasting_map_return)

/* Initialise an empty map of up to `voxels` voxels of side `voxel` (m) in an arena (or measure it); keyframes have up to
 * `points` points. `around` holds every voxel within `radius` (m). Returns what ek_voxel_map_init and ek_index_init
 * return. */
ek_status ek_lasting_map_init(ek_lasting_map *map, ek_arena *arena, size_t voxels, ek_real voxel, ek_real radius,
                              size_t points, uint32_t neighbours);

/* Remove all voxels. */
void ek_lasting_map_clear(ek_lasting_map *map);

/* Add a keyframe: count pairs x y (m) at a pose, which stay within EK_MAX_COORDINATE. */
void ek_lasting_map_add(ek_lasting_map *map, const ek_real *xy, size_t count, ek_pose start_from_base);

/* Index the voxels around a place (m), if they have changed or the place has. EK_NOT_FINITE or EK_OUT_OF_RANGE for the means of
 * voxels, which points within EK_MAX_COORDINATE do not give. */
ek_status ek_lasting_map_near(ek_lasting_map *map, ek_real x, ek_real y);

/* Go back to the centre (m) that the map had before ek_lasting_map_near, after a scan that was refused. Returns what that
 * returns. */
ek_status ek_lasting_map_return(ek_lasting_map *map, ek_real centre_x, ek_real centre_y, int32_t changed);

#ifdef __cplusplus
}
#endif
#endif

/* index.h - exact nearest neighbours of points in the plane.
 *
 * A uniform grid whose cell width follows the density of the points. Points are sorted by cell, row-major, so that
 * neighbouring cells of a row are contiguous in memory. Building is a counting sort, linear in points and cells. The
 * cells of the last cloud are kept if they suit the new one. index_update.h updates an index without building it again.
 */
#ifndef EK_INDEX_H
#define EK_INDEX_H

#include "ek/arena.h"
#include "ek/cell_grid.h"

#ifdef __cplusplus
extern "C" {
#endif

#define EK_NONE UINT32_MAX
#define EK_MAX_SUPPORT 20u /* points of a mean that count: the points of a scan share the error of its pose */

/* Padding of the arrays: loops in index_update.c write one entry or one block beyond the end. */
#define EK_INDEX_SLOTS(capacity) ((size_t)(capacity) + 1u)
#define EK_INDEX_BLOCK 32u /* entries of start */

typedef struct ek_table ek_table;

/* Read only. A slot is a position in the sorted order. */
typedef struct {
    size_t capacity;      /* points */
    size_t cell_capacity; /* cells */
    size_t count;         /* number of points */
    size_t occupied;      /* non-empty cells */
    ek_cell_grid cells;      /* laid over the points */
    ek_real *xy;          /* points by slot, pairs x y (m) */
    uint32_t *id;         /* slot -> index in the cloud */
    uint32_t *start;      /* cell -> its first slot; cells + 1 entries */
    uint32_t *scratch;    /* point -> cell while building */
    uint32_t version;     /* changes with the points */
    const ek_real *normals; /* NULL, or a normal x y per point, in the order of the cloud; set after each change of the
                               points (normals.h) */
    ek_real *deferred;      /* NULL, or `normals` that are computed when first needed (ek_normals_defer) */
    uint32_t neighbours;    /* that define a deferred normal */
    const uint32_t *support; /* NULL: 1 each; or how many points each point is the mean of, 1 or more, in the order of the
                                cloud, of which EK_MAX_SUPPORT count; set after each change of the points (for `share_noise` of
                                icp.h, and for normals.h if `noisy`) */
    int32_t noisy;          /* 1: a mean of n points counts as n in the line that defines a normal; set like `support` */
    const ek_real *seen_from; /* NULL: unknown; or for each point the mean of unit vectors x y to where it was seen from, in
                                 the order of the cloud; set after each change of the points (for EK_METRIC_LINE of icp.h) */
    ek_table *table;      /* NULL, or the table of its neighbours (table.h) */
    int wide;             /* what the processor has: ek_wide() (wide.h) */
} ek_index;

/* Result of a search. */
typedef struct {
    uint32_t slot;    /* EK_NONE: no point is nearer than the limit */
    ek_real distance; /* to that point (m); undefined without one */
    ek_real others;   /* lower bound on the distance to any other point (m); without a slot, to any point */
} ek_neighbour;

#define ek_index_init EK_NAME(index_init)
#define ek_index_build EK_NAME(index_build)
#define ek_index_is_stable EK_NAME(index_is_stable)
#define ek_index_nearest EK_NAME(index_nearest)

/* How many points the point in a slot is the mean of, as far as they count. */
static inline ek_real ek_index_support(const ek_index *index, uint32_t slot)
{
    const uint32_t points = index->support ? index->support[index->id[slot]] : 1u;
    return (ek_real)(points < EK_MAX_SUPPORT ? points : EK_MAX_SUPPORT);
}

/* Initialise an empty index of `capacity` points and `cells` cells in an arena (or measure it).
 * EK_OUT_OF_RANGE: capacity or cells is 0 or above 2^30. Rule of thumb for `cells`: area of the bounding box / area of
 * a cell that holds 3 or 4 points. Fewer cells make searches slower, not wrong. */
ek_status ek_index_init(ek_index *index, ek_arena *arena, size_t capacity, size_t cells);

/* Build the index of a cloud: count pairs x y (m), may be 0. Replaces the previous cloud. EK_TOO_MANY_POINTS;
 * EK_NOT_FINITE; EK_OUT_OF_RANGE: a coordinate larger than EK_MAX_COORDINATE. After an error the index is empty. */
ek_status ek_index_build(ek_index *index, const ek_real *xy, size_t count);

/* 1 if building the index again from its points (one or more) would keep the cells. */
int ek_index_is_stable(const ek_index *index);

/* Find the point nearest to (x, y) that is nearer than `limit` (m); among equally near points, the one with the lowest
 * index in the cloud. `radius` (m, above 0) is the half width of the first search; it affects speed and `others`, not
 * the point found. x and y must be finite. */
ek_neighbour ek_index_nearest(const ek_index *index, ek_real x, ek_real y, ek_real limit,
                              ek_real radius);

#ifdef __cplusplus
}
#endif
#endif

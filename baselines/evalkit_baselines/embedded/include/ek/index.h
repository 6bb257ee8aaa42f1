/* index.h - exact nearest neighbours among the points of a plane.
 *
 * A uniform grid whose cell size follows the density of the points. Points are stored sorted by cell, row after row, so
 * that neighbouring cells of a row are one run of memory. Building is a counting sort, linear in points and cells. It
 * keeps the last cloud's cells where they suit the new one; how a cloud that only gains and loses some points is brought
 * up to date without building stands in merge.h.
 */
#ifndef EK_INDEX_H
#define EK_INDEX_H

#include "ek/arena.h"
#include "ek/frame.h"

#ifdef __cplusplus
extern "C" {
#endif

#define EK_NONE UINT32_MAX

/* Arrays of an index are this much longer than told, so that loops over them may write a little beyond (see merge.c). */
#define EK_INDEX_SLOTS(capacity) ((size_t)(capacity) + 1u)
#define EK_INDEX_BLOCK 32u /* entries of start */

/* Read only; a slot is a position in the sorted order. */
typedef struct {
    size_t capacity;      /* points */
    size_t cell_capacity; /* cells */
    size_t count;         /* points held */
    size_t occupied;      /* cells that hold any */
    ek_frame frame;       /* the cells */
    ek_real *xy;          /* points by slot, pairs x y (m) */
    uint32_t *id;         /* slot -> index in the cloud held */
    uint32_t *start;      /* cell -> its first slot; cells + 1 entries */
    uint32_t *scratch;    /* point -> cell while building */
} ek_index;

/* The answer of a query. */
typedef struct {
    uint32_t slot;    /* EK_NONE: no point is nearer than the limit */
    ek_real distance; /* to it (m); meaningless without one */
    ek_real others;   /* no other point is nearer than this (m); without a slot: no point at all */
} ek_neighbour;

#define ek_index_lay_out EK_NAME(index_lay_out)
#define ek_index_build EK_NAME(index_build)
#define ek_index_settled EK_NAME(index_settled)
#define ek_index_nearest EK_NAME(index_nearest)

/* Lays an empty index for `capacity` points and `cells` cells out in the arena (or measures it).
 * EK_OUT_OF_RANGE: capacity or cells 0, or above 2^30. Cells: about as many as the area of the bounding box has cells
 * holding 3 points; fewer only make queries slower. */
ek_status ek_index_lay_out(ek_index *index, ek_arena *arena, size_t capacity, size_t cells);

/* Takes in a cloud, count pairs x y in metres, in place of the former one. An empty cloud is allowed.
 * EK_TOO_MANY_POINTS; EK_NOT_FINITE; EK_OUT_OF_RANGE: a coordinate beyond EK_LARGEST. After an error the index is empty. */
ek_status ek_index_build(ek_index *index, const ek_real *xy, size_t count);

/* Whether building from the points held, one or more, would keep the cells as they are. */
int ek_index_settled(const ek_index *index);

/* The point nearest to (x, y), if it is nearer than limit (m); of equally near ones that with the lowest index in the
 * cloud. `radius` (m, above 0): how far to look first; the answer is the same for any, `others` and the time are not.
 * x and y must be finite. */
ek_neighbour ek_index_nearest(const ek_index *index, ek_real x, ek_real y, ek_real limit,
                              ek_real radius);

#ifdef __cplusplus
}
#endif
#endif

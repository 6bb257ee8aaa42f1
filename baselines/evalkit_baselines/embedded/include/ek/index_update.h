/* index_update.h - update an index when its cloud loses its oldest points and gains new ones.
 *
 * The result equals building from the new cloud to the bit, in one pass over slots and cells: nine of the ten keyframes
 * of a local map stay, and they stay sorted.
 */
#ifndef EK_INDEX_UPDATE_H
#define EK_INDEX_UPDATE_H

#include "ek/index.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Working memory of updates. `xy` and `id` are swapped with those of the index. */
typedef struct {
    size_t capacity;  /* points */
    ek_real *xy;
    uint32_t *id;
    uint32_t *order;  /* new points sorted by cell, then their cells */
    uint32_t *digits; /* histogram of the radix sort */
} ek_index_updater;

#define ek_index_updater_init EK_NAME(index_updater_init)
#define ek_index_update EK_NAME(index_update)

/* Initialise working memory for an index of `capacity` points. EK_OUT_OF_RANGE: 0 or above 2^30. */
ek_status ek_index_updater_init(ek_index_updater *updater, ek_arena *arena, size_t capacity);

/* Remove the first `removed` points of the cloud and append count pairs x y (m).
 * Builds the index again if a build would choose other cells: a new point lies outside the grid, a quarter of the grid
 * is empty along a side, or cells no longer hold about 3 points.
 * EK_OUT_OF_RANGE: `removed` exceeds the number of points, a coordinate is larger than EK_MAX_COORDINATE, or the index
 * has another capacity; EK_TOO_MANY_POINTS; EK_NOT_FINITE. An error leaves the index unchanged. */
ek_status ek_index_update(ek_index_updater *updater, ek_index *index, size_t removed, const ek_real *xy, size_t count);

#ifdef __cplusplus
}
#endif
#endif

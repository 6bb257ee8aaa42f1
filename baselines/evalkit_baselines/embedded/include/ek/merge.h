/* merge.h - brings an index up to date whose cloud loses its oldest points and gets new ones.
 *
 * What comes out is to the bit what building from the new cloud gives, in one pass over slots and cells: of a local map of
 * ten keyframes nine stay, and they stay sorted.
 */
#ifndef EK_MERGE_H
#define EK_MERGE_H

#include "ek/index.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Memory for updates; `xy` and `id` take turns with those of the index. */
typedef struct {
    size_t capacity;  /* points */
    ek_real *xy;
    uint32_t *id;
    uint32_t *order;  /* new points by their cells; then these cells */
    uint32_t *digits; /* of numbers of cells, counted */
} ek_merge;

#define ek_merge_lay_out EK_NAME(merge_lay_out)
#define ek_merge_update EK_NAME(merge_update)

/* Lays out what updates of an index of `capacity` points need. EK_OUT_OF_RANGE: 0 or above 2^30. */
ek_status ek_merge_lay_out(ek_merge *merge, ek_arena *arena, size_t capacity);

/* Forgets the first `removed` points of the cloud the index holds and appends count pairs x y (m).
 * It builds anew, from what it holds, where a build would choose other cells: when a new point lies outside of the
 * frame, when a quarter of the frame lies empty along a side, or when cells hold no longer about 3 points.
 * EK_OUT_OF_RANGE: removed is more than there is, a coordinate beyond EK_LARGEST, or an index of another capacity;
 * EK_TOO_MANY_POINTS; EK_NOT_FINITE. After an error the index is as it was. */
ek_status ek_merge_update(ek_merge *merge, ek_index *index, size_t removed, const ek_real *xy, size_t count);

#ifdef __cplusplus
}
#endif
#endif

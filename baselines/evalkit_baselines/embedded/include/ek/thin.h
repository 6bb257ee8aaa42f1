/* thin.h - thin a cloud to one mean for each square cell, ordered by cell: first by x, then by y. */
#ifndef EK_THIN_H
#define EK_THIN_H

#include "ek/arena.h"
#include "ek/work.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Working memory for clouds of up to `capacity` points. */
typedef struct {
    size_t capacity;
    uint64_t *key, *other_key;
    uint32_t *order, *other_order;
    uint32_t *digits;
} ek_thinner;

#define ek_thinner_init EK_NAME(thinner_init)
#define ek_thin EK_NAME(thin)

/* Initialise working memory in an arena (or measure it). EK_OUT_OF_RANGE: capacity 0 or above 2^30. */
ek_status ek_thinner_init(ek_thinner *thinner, ek_arena *arena, size_t capacity);

/* Write the mean of the points of each cell of side `size` (m, 0.001 or more): count pairs x y, finite and within
 * EK_MAX_COORDINATE, at most `capacity`; `means` has room for as many. Returns the number of cells. The same cloud gives the same
 * means to the bit. At most 8 operations a point. */
size_t ek_thin(ek_thinner *thinner, const ek_real *xy, size_t count, ek_real size, ek_real *means, ek_work *work);

#ifdef __cplusplus
}
#endif
#endif

/* nearby.h - the nearest points of several places at once.
 *
 * Places that lie beside each other, like the ends of neighbouring beams, have most of their candidates in common: one look
 * into the index serves all of them, and the loops run over places instead of points, without a branch. Distances are
 * compared in single precision and their error is bounded: the set that is found is exact, its order is not.
 */
#ifndef EK_NEARBY_H
#define EK_NEARBY_H

#include "ek/table.h"

#ifdef __cplusplus
extern "C" {
#endif

#define EK_GROUP 8u /* places */

/* For each place up to EK_BLOCK points. One of them is nearest to it where `nearest` is below `others`. */
typedef struct {
    uint32_t slot[EK_BLOCK][EK_GROUP]; /* in no order; EK_NONE where there are fewer */
    ek_real nearest[EK_GROUP];         /* upper bound on the distance from the place to the nearest of them (m) */
    ek_real others[EK_GROUP];          /* lower bound on the distance from the place to all other points (m) */
} ek_nearby;

#define ek_index_nearby EK_NAME(index_nearby)

/* Find the points nearest to EK_GROUP places (m) within a square of half width `radius` (m, above 0) around each; wide:
 * ek_wide(). Returns 0 and finds nothing if more than 256 points are around them, or none in the index. Places must be
 * finite. */
int ek_index_nearby(const ek_index *index, const ek_real x[EK_GROUP], const ek_real y[EK_GROUP], ek_real radius, int wide,
                    ek_nearby *found);

#ifdef __cplusplus
}
#endif
#endif

/* score_grid.h - how well points fit a target: scores of cells, and their maxima over growing squares.
 *
 * Computes the same as ScoreGrid of evalkit's correlative search: 255 where a target point is at a cell's centre, falling
 * with the distance like a Gaussian; level h holds maxima over 2^h by 2^h cells (Olson 2009; Hess et al. 2016).
 */
#ifndef EK_SCORE_GRID_H
#define EK_SCORE_GRID_H

#include "ek/thin.h"

#ifdef __cplusplus
extern "C" {
#endif

#define EK_SCORE_LEVELS 6u /* scores, and maxima over up to 32 by 32 cells */
#define EK_SCORE_FULL 255u

typedef struct {
    size_t capacity;      /* cells of a level */
    uint8_t *level[EK_SCORE_LEVELS];
    int32_t columns, rows;
    ek_real cell;         /* m */
    ek_real left, bottom; /* m */
} ek_score_grid;

#define ek_score_grid_init EK_NAME(score_grid_init)
#define ek_score_grid_draw EK_NAME(score_grid_draw)
#define ek_score_grid_raise EK_NAME(score_grid_raise)

/* Initialise for up to `capacity` cells in an arena (or measure it). EK_OUT_OF_RANGE: below 128 x 128 or above 2^26. */
ek_status ek_score_grid_init(ek_score_grid *grid, ek_arena *arena, size_t capacity);

/* Draw the scores of a target with cells of side `cell` (m), which is the standard deviation too: count pairs x y. Cells
 * farther from (x, y) than the memory reaches are left out. `means` is working memory for count pairs.
 * At most 100 operations a point, and one for 16 cells. */
void ek_score_grid_draw(ek_score_grid *grid, ek_thinner *thinner, const ek_real *xy, size_t count, ek_real cell, ek_real x,
                        ek_real y, ek_real *means, ek_work *work);

/* Compute level 1 to EK_SCORE_LEVELS - 1 from the one below. At most one operation for 8 cells. */
void ek_score_grid_raise(ek_score_grid *grid, uint32_t level, ek_work *work);

#ifdef __cplusplus
}
#endif
#endif

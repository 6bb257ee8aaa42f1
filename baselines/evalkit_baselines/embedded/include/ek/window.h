/* window.h - mark the cells that the beams of one scan cross and hit, one bit per cell, in a square around the sensor.
 */
#ifndef EK_WINDOW_H
#define EK_WINDOW_H

#include "ek/real.h"

#ifdef __cplusplus
extern "C" {
#endif

#define EK_WORD 32u /* bits */

/* Cells, both ends included; none if left > right. */
typedef struct {
    uint32_t left, right, bottom, top;
} ek_marks;

/* A square of cells. The bits of a line are packed into words, lowest cell first; the caller provides their memory, lines *
 * words each. */
typedef struct {
    uint32_t lines;   /* side in cells; a multiple of EK_WORD */
    uint32_t words;   /* lines / EK_WORD */
    uint32_t *across; /* row by row: crossed by flat beams */
    uint32_t *along;  /* column by column: crossed by steep beams */
    uint32_t *ends;   /* row by row: hit */
    uint32_t *outline; /* working memory of ek_window_fill_outline (polygon.h) */
    ek_marks marks;    /* contains all marks */
    uint32_t steep_left, steep_right; /* columns that contain all marks of `along`; none if the first is larger */
    int wide;          /* 0: the processor has no AVX2 (wide.h); the marks are the same */
} ek_window;

/* Transform from points (u, v) to cells of the window: (c u - s v + x, s u + c v + y). Beams start at (start_x,
 * start_y). */
typedef struct {
    ek_real c, s, x, y;
    ek_real start_x, start_y;
} ek_view;

#define ek_window_init EK_NAME(window_init)
#define ek_window_clear EK_NAME(window_clear)
#define ek_window_mark_beams EK_NAME(window_mark_beams)
#define ek_window_read_block EK_NAME(window_read_block)

/* Clear all of the memory of a window. */
void ek_window_init(ek_window *window);

/* Clear every mark. */
void ek_window_clear(ek_window *window);

/* Extend the cells that contain all marks by one cell. */
static inline void ek_marks_extend(ek_marks *marks, uint32_t column, uint32_t row)
{
    marks->left = column < marks->left ? column : marks->left;
    marks->right = column > marks->right ? column : marks->right;
    marks->bottom = row < marks->bottom ? row : marks->bottom;
    marks->top = row > marks->top ? row : marks->top;
}

/* Mark the cells that the beams to count points (pairs u v) cross, first and last cell included; if `hits` is not 0
 * also mark the end cells as hit. The start must lie inside the window. Returns the number of beams that end outside
 * the window; they are ignored. Cells as in Amanatides and Woo 1987; a beam exactly through a corner goes diagonally.
 */
uint32_t ek_window_mark_beams(ek_window *window, const ek_view *view, const ek_real *points, size_t count, int hits);

/* Read the crossed cells of EK_WORD rows from `row` (a multiple of EK_WORD) and of the columns of word `word`. */
void ek_window_read_block(const ek_window *window, uint32_t row, uint32_t word, uint32_t crossed[EK_WORD]);

#ifdef __cplusplus
}
#endif
#endif

/* window.h - which cells around a sensor the beams of one scan cross and end in, one bit a cell. */
#ifndef EK_WINDOW_H
#define EK_WINDOW_H

#include "ek/real.h"

#ifdef __cplusplus
extern "C" {
#endif

#define EK_WORD 32u /* bits */

/* A square of cells; the bits of a line are packed into words, lowest cell first. */
typedef struct {
    uint32_t lines;   /* side in cells; a multiple of EK_WORD */
    uint32_t words;   /* lines / EK_WORD */
    uint32_t *across; /* row by row: crossed by flat beams */
    uint32_t *along;  /* column by column: crossed by steep beams */
    uint32_t *ends;   /* row by row: hit */
} ek_window;

/* How points lie in the window, in cells: (c u - s v + x, s u + c v + y). The beams start at (start_x, start_y). */
typedef struct {
    ek_real c, s, x, y;
    ek_real start_x, start_y;
} ek_view;

#define ek_window_clear EK_NAME(window_clear)
#define ek_window_add EK_NAME(window_add)
#define ek_window_block EK_NAME(window_block)

/* Unmarks every cell. */
void ek_window_clear(ek_window *window);

/* Marks the cells that beams from the start to count points (pairs u v) cross, start and end included, and where `hits`
 * is not 0 their ends as hit. The start must lie inside. Says how many beams end outside of the window: those are left
 * out. The cells are those of Amanatides and Woo 1987; exactly through a corner goes diagonally. */
uint32_t ek_window_add(ek_window *window, const ek_view *view, const ek_real *points, size_t count, int hits);

/* The cells crossed in the block of EK_WORD rows from `row` (a multiple of it) and the columns of word `word`. */
void ek_window_block(const ek_window *window, uint32_t row, uint32_t word, uint32_t crossed[EK_WORD]);

#ifdef __cplusplus
}
#endif
#endif

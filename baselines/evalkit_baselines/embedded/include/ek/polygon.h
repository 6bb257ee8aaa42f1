/* polygon.h - mark the cells inside the outline of one scan: each once, instead of once for every beam across it. */
#ifndef EK_POLYGON_H
#define EK_POLYGON_H

#include "ek/window.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ek_window_fill_outline EK_NAME(window_fill_outline)

/* Mark the cells whose centre lies between neighbouring beams of a scan, and the end cells of the beams as hit. points:
 * count pairs u v in firing order. The start must lie inside the window.
 *
 * The outline goes from end to end. Between two beams that are more than `widest_gap` (rad, below pi / 2) apart, or
 * turn against the direction of the scan, nothing is marked. Where one of them is much longer (an edge, and not a wall
 * seen at a small angle), cells are marked up to the shorter one. A beam without such an area on both sides is also drawn
 * as ek_window_mark_beams does. Several turns are marked one after the other. window->outline is working memory, zero
 * between calls. Returns the number of beams that end outside the window; they are ignored. */
uint32_t ek_window_fill_outline(ek_window *window, const ek_view *view, const ek_real *points, size_t count,
                                ek_real widest_gap);

#ifdef __cplusplus
}
#endif
#endif

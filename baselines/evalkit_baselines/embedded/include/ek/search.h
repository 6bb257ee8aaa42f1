/* search.h - search a window of motions for the best score of a cloud in a score grid: branch and bound, in slices.
 *
 * Exact: the best score is that of an exhaustive search of the lattice, as in evalkit's correlative search (Hess et al.
 * 2016, algorithm 3). Here the angles are searched one after the other, from the middle of the window outwards, so that
 * memory does not depend on their number.
 */
#ifndef EK_SEARCH_H
#define EK_SEARCH_H

#include "ek/score_grid.h"
#include "ek/se2.h"

#ifdef __cplusplus
extern "C" {
#endif

#define EK_SEARCH_ROOTS 64u /* blocks of the first level; a window is at most 8 by 8 of them */
#define EK_SEARCH_STACK (EK_SEARCH_ROOTS + 4u * EK_SEARCH_LEVELS_BELOW)
#define EK_SEARCH_LEVELS_BELOW 5u
#define EK_SEARCH_MAX_HALF 127 /* cells */

/* Motions target_from_source up to x and y (m) and theta (rad) from a centre; pi or more: all headings. */
typedef struct {
    ek_pose centre;
    ek_real x, y, theta;
} ek_search_window;

/* Scores fall by 1 / (1 + 0.02 times the squared distance from the centre in these units); zeros: they do not. */
typedef struct {
    ek_real x, y, theta; /* m, m, rad */
} ek_search_prior;

/* A square block of motions of one angle, by its lowest cells from the centre. */
typedef struct {
    int32_t x, y;
    uint32_t level;
    ek_real bound;
} ek_search_block;

typedef struct {
    size_t capacity;
    const ek_score_grid *grid;
    const ek_real *xy;    /* points of the source, pairs (m) */
    size_t count;
    int32_t *column, *row; /* cells of the points at the current angle */
    ek_search_window window;
    ek_search_prior prior;
    int32_t half_x, half_y; /* cells */
    uint32_t first_level;
    uint32_t angles, angle;  /* number, and how many were begun */
    int32_t lowest;          /* angle number of the first one */
    ek_real step, offset;    /* rad: between angles; of the current one from the centre */
    ek_search_block stack[EK_SEARCH_STACK];
    size_t waiting;
    int32_t found;
    ek_real score; /* best so far, or the smallest that counts */
    ek_real left_out; /* where no motion was found: upper bound on the score of every one */
    ek_pose best;
    uint64_t evaluated; /* blocks and motions */
} ek_search;

#define ek_search_init EK_NAME(search_init)
#define ek_search_begin EK_NAME(search_begin)
#define ek_search_work EK_NAME(search_work)

/* Initialise for sources of up to `capacity` points in an arena (or measure it). EK_OUT_OF_RANGE: 0 or above 2^20. */
ek_status ek_search_init(ek_search *search, ek_arena *arena, size_t capacity);

/* Begin a search: count pairs x y (m), which stay in place until it ends. Motions count that score above min_score (0 to 1).
 * The window is cut at EK_SEARCH_MAX_HALF cells. EK_NO_POINTS, EK_TOO_MANY_POINTS. */
ek_status ek_search_begin(ek_search *search, const ek_score_grid *grid, const ek_real *xy, size_t count,
                          const ek_search_window *window, const ek_search_prior *prior, ek_real min_score);

/* Go on while work is left; 1: ended, and search->best holds the motion if search->found. A part has at most 64 times
 * the points operations (the first blocks of an angle). */
int ek_search_work(ek_search *search, ek_work *work);

#ifdef __cplusplus
}
#endif
#endif

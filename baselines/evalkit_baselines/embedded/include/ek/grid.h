/* grid.h - log-odds occupancy grid from scans with known poses (paper, equations 10 and 11).
 *
 * Computes the same as the NumPy reference evalkit_baselines/paper/grid.py. A beam crosses the cells of Amanatides and
 * Woo 1987. A scan changes a cell once; occupied wins over free. The cells of a scan are first marked as bits in a
 * window around the sensor, then added to the map, 32 cells at a time. With `polygon` the cells inside the outline of the
 * scan are marked instead (polygon.h), each once.
 */
#ifndef EK_GRID_H
#define EK_GRID_H

#include "ek/arena.h"
#include "ek/se2.h"
#include "ek/window.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Value of a cell that no beam has touched. Other cells hold log-odds x 1000: p = 1 / (1 + exp(-cell / 1000)). */
#define EK_UNKNOWN INT16_MIN

typedef struct {
    ek_real resolution;                  /* width of a cell (m); 0.001 to 10 */
    ek_real l_occ, l_free, l_min, l_max; /* log-odds; l_free, l_min <= 0 <= l_occ, l_max; within [-15, 15] */
    ek_real range_max;                   /* longest beam (m); beams longer than this + 1 m are ignored */
    uint32_t columns, rows;              /* of the map; multiples of 32 */
    int32_t left, bottom;                /* cell numbers of the lower left cell; multiples of 32 */
    int32_t rolling;                     /* 1: the map follows the sensor and drops cells that leave it; 0: fixed */
    int32_t polygon;                     /* 1: free the cells inside the outline of a scan; 0: those its beams cross */
    ek_real widest_gap;                  /* of an outline: between neighbouring beams (rad); 0 to 1.5 */
} ek_grid_parameters;

/* Cell (column, row) covers [left + column, left + column + 1) x [bottom + row, ...) times the resolution. */
typedef struct {
    ek_grid_parameters parameters;
    int32_t left, bottom; /* current lower left cell, counted from the world's origin */
    int16_t *cells;       /* rows x columns, row-major, lowest y first */
    ek_window window;     /* marked cells of one scan */
    int32_t window_left, window_bottom;
    uint32_t ignored_beams; /* beams of the last scan that end outside the window */
    uint32_t touched_cells; /* cells of the map that the last scan changed */
} ek_grid;

#define ek_grid_default EK_NAME(grid_default)
#define ek_grid_check EK_NAME(grid_check)
#define ek_grid_init EK_NAME(grid_init)
#define ek_grid_add_scan EK_NAME(grid_add_scan)
#define ek_grid_clear EK_NAME(grid_clear)

/* Default parameters: 5 cm cells, +-0.847 clamped at +-5, beams to 12 m, fixed map of 1024 x 1024 cells around the
 * origin. */
ek_grid_parameters ek_grid_default(void);

/* Check parameters: EK_OK, EK_NOT_FINITE or EK_OUT_OF_RANGE (a rolling map must be larger than a scan's window). */
ek_status ek_grid_check(const ek_grid_parameters *parameters);

/* Initialise a map in an arena (or measure it) and clear it. Returns what ek_grid_check returns. */
ek_status ek_grid_init(ek_grid *grid, ek_arena *arena, const ek_grid_parameters *parameters);

/* Set every cell to EK_UNKNOWN. */
void ek_grid_clear(ek_grid *grid);

/* Add a scan: hits (count pairs x y, m) and the end points of beams without return (misses), which only free cells. All
 * points are in one frame with pose world_from_points, in firing order; the beams start at (start_x, start_y) of that frame. Cells
 * outside a fixed map are ignored. EK_NOT_FINITE: pose, start or point; EK_OUT_OF_RANGE: a pose larger than
 * EK_MAX_COORDINATE. An error leaves the map unchanged. */
ek_status ek_grid_add_scan(ek_grid *grid, ek_pose world_from_points, ek_real start_x, ek_real start_y,
                           const ek_real *hits, size_t count, const ek_real *misses, size_t miss_count);

#ifdef __cplusplus
}
#endif
#endif

/* grid.h - occupancy in log-odds along every beam of scans with known poses (the paper, equations 10 and 11).
 *
 * The same meaning as the NumPy twin evalkit_baselines/paper/grid.py: the cells a beam crosses are those of Amanatides
 * and Woo 1987; a scan adds to a cell once, occupied before free. The cells of one scan are first marked as bits in a
 * window around the sensor, then added to the map 16 at a time.
 */
#ifndef EK_GRID_H
#define EK_GRID_H

#include "ek/arena.h"
#include "ek/se2.h"
#include "ek/window.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A cell no beam has touched; others hold thousandths of log-odds: p = 1 / (1 + exp(-cell / 1000)). */
#define EK_UNKNOWN INT16_MIN

typedef struct {
    ek_real resolution;                  /* m, side of a cell; 0.001 to 10 */
    ek_real l_occ, l_free, l_min, l_max; /* log-odds; l_free and l_min are negative; all within [-15, 15] */
    ek_real range_max;                   /* m, longest beam; ends farther than this + 1 m are left out */
    uint32_t columns, rows;              /* of the map; multiples of 32 */
    int32_t left, bottom;                /* cell numbers of the lower left cell; multiples of 32 */
    int32_t rolling;                     /* 1: the map follows the sensor and forgets what leaves it; 0: it stays */
} ek_grid_parameters;

/* Cell (column, row) covers [left + column, left + column + 1) x [bottom + row, ...) times the resolution. */
typedef struct {
    ek_grid_parameters parameters;
    int32_t left, bottom; /* now, in cells from the world's origin */
    int16_t *cells;       /* rows x columns, row by row from the lowest y */
    ek_window window;     /* the cells of one scan */
    int32_t window_left, window_bottom;
    uint32_t left_out;    /* beams of the last scan whose end lay beyond the window */
    uint32_t touched;     /* cells of the last scan within the map */
} ek_grid;

#define ek_grid_default EK_NAME(grid_default)
#define ek_grid_check EK_NAME(grid_check)
#define ek_grid_lay_out EK_NAME(grid_lay_out)
#define ek_grid_add EK_NAME(grid_add)
#define ek_grid_clear EK_NAME(grid_clear)

/* The paper's values: 5 cm, +-0.847 clamped at +-5, beams to 12 m; 1024 x 1024 cells around the origin, fixed. */
ek_grid_parameters ek_grid_default(void);

/* EK_OK, EK_NOT_FINITE or EK_OUT_OF_RANGE (a rolling map must be larger than the window of one scan). */
ek_status ek_grid_check(const ek_grid_parameters *parameters);

/* Lays a map out (and clears it, unless it only measures); answers as ek_grid_check. */
ek_status ek_grid_lay_out(ek_grid *grid, ek_arena *arena, const ek_grid_parameters *parameters);

/* Makes every cell EK_UNKNOWN. */
void ek_grid_clear(ek_grid *grid);

/* Adds a scan: hits (count pairs x y, m) and, if beams without return shall clear, misses, all in one frame whose pose is
 * world_from_points; the beams start at (start_x, start_y) of that frame. Cells outside of a fixed map are ignored.
 * EK_NOT_FINITE: a pose, start or point; EK_OUT_OF_RANGE: a pose beyond EK_LARGEST. After an error the map is as it was.
 */
ek_status ek_grid_add(ek_grid *grid, ek_pose world_from_points, ek_real start_x, ek_real start_y, const ek_real *hits,
                      size_t count, const ek_real *misses, size_t miss_count);

#ifdef __cplusplus
}
#endif
#endif

/* cell_grid.h - square cells that cover the bounding box of a cloud. */
#ifndef EK_CELL_GRID_H
#define EK_CELL_GRID_H

#include "ek/real.h"
#include "ek/status.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Bounding box of a cloud (m). */
typedef struct {
    ek_real left, right, bottom, top;
} ek_bounds;

typedef struct {
    uint32_t columns, rows;
    ek_real left, bottom;      /* lower left corner (m) */
    ek_real cell, per_cell;    /* cell width (m) and its inverse */
    ek_real margin;            /* bound on the rounding error of a distance (m) */
    int finest;                /* 1: smaller cells would need more memory or be below the minimum width */
} ek_cell_grid;

#define ek_bounds_compute EK_NAME(bounds_compute)
#define ek_cell_grid_fit EK_NAME(cell_grid_fit)
#define ek_cell_grid_contains EK_NAME(cell_grid_contains)
#define ek_cell_grid_spare_lines EK_NAME(cell_grid_spare_lines)
#define ek_cell_grid_suits EK_NAME(cell_grid_suits)

/* Compute the bounding box of count pairs x y (m); wide: ek_wide(). Without points it is empty: right < left.
 * EK_NOT_FINITE; EK_OUT_OF_RANGE: a coordinate is larger than EK_MAX_COORDINATE. */
ek_status ek_bounds_compute(const ek_real *xy, size_t count, int wide, ek_bounds *bounds);

/* Cover a bounding box and a border around it with cells of the given width (m), or with wider cells if more than
 * `max_cells` (1 or more) would be needed. The border is 1/16 of width and height on each side, or 1/64 if the larger
 * border would need wider cells. */
ek_cell_grid ek_cell_grid_fit(const ek_bounds *bounds, ek_real cell, size_t max_cells);

/* 1 if the bounding box lies inside the grid. A zeroed grid contains nothing. */
int ek_cell_grid_contains(const ek_cell_grid *grid, const ek_bounds *bounds);

/* Number of empty columns (rows) along one side, of `lines` in all, from which the grid is too large. */
static inline uint32_t ek_cell_grid_spare_lines(uint32_t lines)
{
    return lines / 4u + 1u;
}

/* 1 if the bounding box lies inside the grid and the grid is not much larger. */
int ek_cell_grid_suits(const ek_cell_grid *grid, const ek_bounds *bounds);

/* Row-major index of the cell that contains a pair x y; the pair must lie inside the grid. */
static inline uint32_t ek_cell_grid_index(const ek_cell_grid *grid, const ek_real *xy)
{
    /* not negative and below 2^20: a signed conversion is exact, and processors have an instruction for it */
    const uint32_t column = (uint32_t)(int32_t)((xy[0] - grid->left) * grid->per_cell);
    const uint32_t row = (uint32_t)(int32_t)((xy[1] - grid->bottom) * grid->per_cell);
    return row * grid->columns + column;
}

/* Cell number of a coordinate along one axis (in cells), clamped to [0, last]. */
static inline int32_t ek_cell_grid_clamp(ek_real place, int32_t last)
{
    const ek_real within = place > EK_R(0.0) ? place : EK_R(0.0);
    return within < (ek_real)last ? (int32_t)within : last;
}

/* Columns and rows of cells, both ends included. */
typedef struct {
    int32_t left, right, bottom, top;
} ek_cell_box;

/* Cells that a square of half width `radius` (m) around (x, y) touches, clamped to the grid. */
static inline ek_cell_box ek_cell_grid_box(const ek_cell_grid *grid, ek_real x, ek_real y, ek_real radius)
{
    const ek_real column = (x - grid->left) * grid->per_cell, row = (y - grid->bottom) * grid->per_cell;
    const ek_real reach = radius * grid->per_cell;
    const int32_t last_column = (int32_t)grid->columns - 1, last_row = (int32_t)grid->rows - 1;
    ek_cell_box box;
    box.left = ek_cell_grid_clamp(column - reach, last_column);
    box.right = ek_cell_grid_clamp(column + reach, last_column);
    box.bottom = ek_cell_grid_clamp(row - reach, last_row);
    box.top = ek_cell_grid_clamp(row + reach, last_row);
    return box;
}

/* 1 if a box contains every cell of the grid. */
static inline int ek_cell_grid_is_all(const ek_cell_grid *grid, const ek_cell_box *box)
{
    return box->left == 0 && box->bottom == 0 && box->right == (int32_t)grid->columns - 1 &&
           box->top == (int32_t)grid->rows - 1;
}

#ifdef __cplusplus
}
#endif
#endif

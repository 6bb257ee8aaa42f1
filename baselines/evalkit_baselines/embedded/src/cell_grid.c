#include "ek/cell_grid.h"
#include "ek/tally.h"
#include "ek/wide.h"
#include "lanes.h"

#include <string.h>

#define MAX_ACROSS EK_R(1048576) /* cells per side: exact in a float */
#define MIN_CELL EK_R(1e-3) /* m */
#define ROOM EK_R(0.0625) /* border as a share of width and height: the grid is kept until a cloud leaves it */
#define LITTLE_ROOM EK_R(0.015625) /* the same if a larger border would need wider cells */
#define WIDER EK_R(1.1)

EK_LOOP ek_status span_points(const ek_real *xy, size_t count, ek_bounds *bounds)
{
    ek_real left = EK_MAX_COORDINATE, right = -EK_MAX_COORDINATE, bottom = EK_MAX_COORDINATE, top = -EK_MAX_COORDINATE;
    for (size_t i = 0; i < count; i++) {
        const ek_real x = xy[2u * i], y = xy[2u * i + 1u];
        if (!(EK_FABS(x) <= EK_MAX_COORDINATE && EK_FABS(y) <= EK_MAX_COORDINATE)) {
            return isfinite(x) && isfinite(y) ? EK_OUT_OF_RANGE : EK_NOT_FINITE;
        }
        left = x < left ? x : left;
        right = x > right ? x : right;
        bottom = y < bottom ? y : bottom;
        top = y > top ? y : top;
    }
    bounds->left = left;
    bounds->right = right;
    bounds->bottom = bottom;
    bounds->top = top;
    return EK_OK;
}

#if EK_COPIED
#define span_points_avx2 span_points

EK_WIDEST static ek_status span_points_avx512(const ek_real *xy, size_t count, ek_bounds *bounds)
{
    ek_lanes left = EK_LANES_OF(set1)(EK_MAX_COORDINATE), bottom = left;
    ek_lanes right = EK_LANES_OF(set1)(-EK_MAX_COORDINATE), top = right;
    uint32_t wrong = 0u;
    for (size_t i = 0; i < count; i += EK_LANES) {
        const uint32_t some = count - i < EK_LANES ? (uint32_t)(count - i) : EK_LANES;
        const __mmask8 these = (__mmask8)((1u << some) - 1u);
        ek_lanes x, y;
        ek_split_pairs(xy + 2u * i, some, &x, &y);
        left = EK_LANES_OF(mask_min)(left, these, left, x);
        right = EK_LANES_OF(mask_max)(right, these, right, x);
        bottom = EK_LANES_OF(mask_min)(bottom, these, bottom, y);
        top = EK_LANES_OF(mask_max)(top, these, top, y);
        wrong |= EK_NAN(x, y);
    }
    const ek_lanes zero = EK_LANES_OF(setzero)();
    bounds->left = ek_least_lane(left);
    bounds->right = -ek_least_lane(EK_LANES_OF(sub)(zero, right));
    bounds->bottom = ek_least_lane(bottom);
    bounds->top = -ek_least_lane(EK_LANES_OF(sub)(zero, top));
    wrong |= bounds->left < -EK_MAX_COORDINATE || bounds->right > EK_MAX_COORDINATE || bounds->bottom < -EK_MAX_COORDINATE ||
             bounds->top > EK_MAX_COORDINATE;
    return wrong ? span_points(xy, count, bounds) : EK_OK;
}
#endif

ek_status ek_bounds_compute(const ek_real *xy, size_t count, int wide, ek_bounds *bounds)
{
    EK_COUNT(EK_SLOTS, count);
    return EK_CALL(wide, span_points, (xy, count, bounds));
}

/* Cover a bounding box and a border of `share` of its size with cells of width `cell`; 0 if max_cells are too few. */
static int cover(ek_cell_grid *grid, const ek_bounds *bounds, ek_real cell, ek_real share, size_t max_cells)
{
    EK_COUNT(EK_SLOTS, 8u); /* as much work as so many points */
    const ek_real per_cell = EK_R(1.0) / cell;
    const ek_real beside = EK_FLOOR(share * (bounds->right - bounds->left) * per_cell);
    const ek_real below = EK_FLOOR(share * (bounds->top - bounds->bottom) * per_cell);
    const ek_real left = bounds->left - beside * cell, bottom = bounds->bottom - below * cell;
    const ek_real columns = EK_FLOOR((bounds->right - left) * per_cell) + EK_R(1.0) + beside;
    const ek_real rows = EK_FLOOR((bounds->top - bottom) * per_cell) + EK_R(1.0) + below;
    if (!(columns <= MAX_ACROSS && rows <= MAX_ACROSS) || (uint64_t)columns * (uint64_t)rows > max_cells) {
        return 0;
    }
    const ek_real right = left + columns * cell, top = bottom + rows * cell;
    const ek_real far_x = EK_FABS(left) > EK_FABS(right) ? EK_FABS(left) : EK_FABS(right);
    const ek_real far_y = EK_FABS(bottom) > EK_FABS(top) ? EK_FABS(bottom) : EK_FABS(top);
    grid->columns = (uint32_t)columns;
    grid->rows = (uint32_t)rows;
    grid->left = left;
    grid->bottom = bottom;
    grid->cell = cell;
    grid->per_cell = per_cell;
    grid->margin = EK_R(16.0) * EK_EPSILON * (EK_R(1.0) + far_x + far_y);
    return 1;
}

ek_cell_grid ek_cell_grid_fit(const ek_bounds *bounds, ek_real cell, size_t max_cells)
{
    ek_cell_grid grid;
    memset(&grid, 0, sizeof grid);
    grid.finest = cell <= MIN_CELL;
    cell = grid.finest ? MIN_CELL : cell;
    if (cover(&grid, bounds, cell, ROOM, max_cells)) {
        return grid;
    }
    while (!cover(&grid, bounds, cell, LITTLE_ROOM, max_cells)) {
        cell *= WIDER;
        grid.finest = 1;
    }
    return grid;
}

int ek_cell_grid_contains(const ek_cell_grid *grid, const ek_bounds *bounds)
{
    return bounds->left >= grid->left && (bounds->right - grid->left) * grid->per_cell < (ek_real)grid->columns &&
           bounds->bottom >= grid->bottom && (bounds->top - grid->bottom) * grid->per_cell < (ek_real)grid->rows;
}

int ek_cell_grid_suits(const ek_cell_grid *grid, const ek_bounds *bounds)
{
    if (!ek_cell_grid_contains(grid, bounds)) {
        return 0;
    }
    const uint32_t across = ek_cell_grid_spare_lines(grid->columns), up = ek_cell_grid_spare_lines(grid->rows);
    return (uint32_t)((bounds->left - grid->left) * grid->per_cell) < across &&
           (uint32_t)((bounds->right - grid->left) * grid->per_cell) + across >= grid->columns &&
           (uint32_t)((bounds->bottom - grid->bottom) * grid->per_cell) < up &&
           (uint32_t)((bounds->top - grid->bottom) * grid->per_cell) + up >= grid->rows;
}

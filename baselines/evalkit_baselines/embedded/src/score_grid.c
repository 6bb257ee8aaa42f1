#include "ek/score_grid.h"

#include <string.h>

#define MIN_CELLS ((size_t)128 * 128)
#define MAX_CELLS ((size_t)1 << 26)
#define KERNEL 4 /* cells: beyond three standard deviations, which are three cells */
#define BORDER ((1 << (EK_SCORE_LEVELS - 1u)) + KERNEL)
#define STEPS (2 * KERNEL + 1)
#define DRAW_WORK 92u

#ifdef EK_FLOAT
#define EXP expf
#define ROUND rintf
#else
#define EXP exp
#define ROUND rint
#endif

ek_status ek_score_grid_init(ek_score_grid *grid, ek_arena *arena, size_t capacity)
{
    if (!grid || !arena) {
        return EK_NULL_POINTER;
    }
    if (capacity < MIN_CELLS || capacity > MAX_CELLS) {
        return EK_OUT_OF_RANGE;
    }
    memset(grid, 0, sizeof *grid);
    grid->capacity = capacity;
    for (size_t k = 0; k < EK_SCORE_LEVELS; k++) {
        grid->level[k] = (uint8_t *)ek_arena_alloc(arena, capacity, 1u);
    }
    return EK_OK;
}

/* Half width in cells of the square around a place within which cells are drawn whatever their spread. */
static int64_t reach_of(const ek_score_grid *grid)
{
    const int64_t side = (int64_t)floor(sqrt((double)grid->capacity));
    return (side - BORDER - KERNEL - 4) / 2;
}

/* Lay the grid over the means; returns the number of those that are kept. */
static size_t fit_cells(ek_score_grid *grid, ek_real *means, size_t count, ek_real x, ek_real y)
{
    const ek_real cell = grid->cell;
    ek_real low[2] = {EK_FAR, EK_FAR}, high[2] = {-EK_FAR, -EK_FAR};
    size_t kept = 0u;
    for (int crop = 0; crop < 2; crop++) {
        const ek_real reach = (ek_real)reach_of(grid) * cell;
        kept = 0u;
        low[0] = low[1] = EK_FAR;
        high[0] = high[1] = -EK_FAR;
        for (size_t k = 0; k < count; k++) {
            const ek_real u = means[2u * k], v = means[2u * k + 1u];
            if (crop && !(EK_FABS(u - x) <= reach && EK_FABS(v - y) <= reach)) {
                continue;
            }
            low[0] = u < low[0] ? u : low[0];
            high[0] = u > high[0] ? u : high[0];
            low[1] = v < low[1] ? v : low[1];
            high[1] = v > high[1] ? v : high[1];
            means[2u * kept] = u;
            means[2u * kept++ + 1u] = v;
        }
        if (kept == 0u) {
            break;
        }
        const ek_real left = EK_FLOOR(low[0] / cell) - (ek_real)BORDER, bottom = EK_FLOOR(low[1] / cell) - (ek_real)BORDER;
        const ek_real columns = EK_FLOOR(high[0] / cell) - left + (ek_real)(KERNEL + 2);
        const ek_real rows = EK_FLOOR(high[1] / cell) - bottom + (ek_real)(KERNEL + 2);
        if (columns * rows <= (ek_real)grid->capacity) {
            grid->columns = (int32_t)columns;
            grid->rows = (int32_t)rows;
            grid->left = left * cell;
            grid->bottom = bottom * cell;
            return kept;
        }
    }
    grid->columns = grid->rows = 1;
    return 0u;
}

/* Draw a Gaussian around one mean (in cells from the lower left corner). */
static void draw_point(ek_score_grid *grid, ek_real x, ek_real y)
{
    const int32_t column = (int32_t)EK_FLOOR(x), row = (int32_t)EK_FLOOR(y);
    const ek_real least = EXP(EK_R(-4.5)); /* three standard deviations */
    ek_real across[STEPS], up[STEPS];
    for (int k = 0; k < STEPS; k++) {
        const ek_real u = (ek_real)(column + k - KERNEL) + EK_R(0.5) - x, v = (ek_real)(row + k - KERNEL) + EK_R(0.5) - y;
        across[k] = EXP(EK_R(-0.5) * u * u);
        up[k] = EXP(EK_R(-0.5) * v * v);
    }
    for (int j = 0; j < STEPS; j++) {
        uint8_t *const line = grid->level[0] + (size_t)(row + j - KERNEL) * (size_t)grid->columns + column - KERNEL;
        for (int k = 0; k < STEPS; k++) {
            const ek_real value = up[j] * across[k];
            const uint8_t score = value >= least ? (uint8_t)ROUND((ek_real)EK_SCORE_FULL * value) : 0u;
            line[k] = score > line[k] ? score : line[k];
        }
    }
}

void ek_score_grid_draw(ek_score_grid *grid, ek_thinner *thinner, const ek_real *xy, size_t count, ek_real cell, ek_real x,
                        ek_real y, ek_real *means, ek_work *work)
{
    grid->cell = cell;
    const size_t cells = ek_thin(thinner, xy, count, cell, means, work);
    const size_t kept = fit_cells(grid, means, cells, x, y);
    const size_t all = (size_t)grid->columns * (size_t)grid->rows;
    memset(grid->level[0], 0, all);
    for (size_t k = 0; k < kept; k++) {
        draw_point(grid, means[2u * k] / cell - EK_FLOOR(grid->left / cell + EK_R(0.5)),
                   means[2u * k + 1u] / cell - EK_FLOOR(grid->bottom / cell + EK_R(0.5)));
    }
    ek_work_spend(work, DRAW_WORK * (uint64_t)kept + all / 16u);
}

void ek_score_grid_raise(ek_score_grid *grid, uint32_t level, ek_work *work)
{
    const size_t columns = (size_t)grid->columns, rows = (size_t)grid->rows, step = (size_t)1 << (level - 1u);
    for (size_t row = 0; row < rows; row++) { /* rows upwards: the one above is still of the level below */
        const uint8_t *const EK_RESTRICT low = grid->level[level - 1u] + row * columns;
        const uint8_t *const EK_RESTRICT high = row + step < rows ? low + step * columns : low;
        uint8_t *const EK_RESTRICT out = grid->level[level] + row * columns;
        for (size_t k = 0; k < columns; k++) {
            out[k] = low[k] > high[k] ? low[k] : high[k];
        }
        for (size_t k = 0; k + step < columns; k++) {
            out[k] = out[k] > out[k + step] ? out[k] : out[k + step];
        }
    }
    ek_work_spend(work, columns * rows / 8u);
}

/* Building of index.h: a counting sort by cells. */
#include "ek/index.h"
#include "ek/tally.h"
#include "ek/wide.h"
#include "lanes.h"

#include <string.h>

#define DENSITY EK_R(EK_GROUPED ? 4.0 : 3.0) /* target number of points per occupied cell; groups of places read whole rows */
#define SPARSE (EK_R(0.6) * DENSITY)
#define DENSE (EK_R(1.7) * DENSITY)

/* Find the cell of each point. */
EK_LOOP void locate(const ek_cell_grid *grid, const ek_real *EK_RESTRICT xy, size_t count, uint32_t *EK_RESTRICT cells)
{
    for (size_t i = 0; i < count; i++) {
        cells[i] = ek_cell_grid_index(grid, xy + 2u * i);
    }
}

#if EK_COPIED
#define locate_avx2 locate

EK_WIDEST static void locate_avx512(const ek_cell_grid *grid, const ek_real *xy, size_t count, uint32_t *cells)
{
    const ek_lanes left = EK_LANES_OF(set1)(grid->left), bottom = EK_LANES_OF(set1)(grid->bottom);
    const ek_lanes per_cell = EK_LANES_OF(set1)(grid->per_cell);
    const __m256i columns = _mm256_set1_epi32((int32_t)grid->columns);
    size_t i = 0;
    for (; i + EK_LANES <= count; i += EK_LANES) {
        ek_lanes x, y;
        ek_split_pairs(xy + 2u * i, EK_LANES, &x, &y);
        const __m256i column = ek_whole_lanes(EK_LANES_OF(mul)(EK_LANES_OF(sub)(x, left), per_cell));
        const __m256i row = ek_whole_lanes(EK_LANES_OF(mul)(EK_LANES_OF(sub)(y, bottom), per_cell));
        ek_store_numbers(cells + i, _mm256_add_epi32(_mm256_mullo_epi32(row, columns), column));
    }
    locate(grid, xy + 2u * i, count - i, cells + i);
}
#endif

/* Count the points of each cell (stored two entries later) and the occupied cells. */
static void count_cells(ek_index *index, const ek_real *xy, size_t count)
{
    const size_t entries = (size_t)index->cells.rows * index->cells.columns + 2u;
    uint32_t *const EK_RESTRICT counts = index->start + 2;
    const uint32_t *const EK_RESTRICT cells = index->scratch;
    size_t occupied = 0u;
    EK_COUNT(EK_CELLS, entries);
    EK_COUNT(EK_SLOTS, count);
    memset(index->start, 0, entries * sizeof(uint32_t));
    EK_CALL(index->wide, locate, (&index->cells, xy, count, index->scratch));
    for (size_t i = 0; i < count; i++) {
        occupied += counts[cells[i]]++ == 0u;
    }
    index->occupied = occupied;
}

/* Replace each number by the sum of those up to it. */
EK_LOOP void sum_up(uint32_t *numbers, size_t count)
{
    uint32_t sum = 0u;
    for (size_t k = 0; k < count; k++) {
        sum += numbers[k];
        numbers[k] = sum;
    }
}

#if EK_COPIED
#define sum_up_avx2 sum_up

EK_WIDEST static void sum_up_avx512(uint32_t *numbers, size_t count)
{
    const __m512i none = _mm512_setzero_si512(), last = _mm512_set1_epi32(15);
    __m512i before = none;
    for (size_t k = 0; k < count; k += 16u) {
        const __mmask16 these = (__mmask16)(count - k < 16u ? (1u << (count - k)) - 1u : 0xFFFFu);
        __m512i sums = _mm512_maskz_loadu_epi32(these, numbers + k);
        sums = _mm512_add_epi32(sums, _mm512_alignr_epi32(sums, none, 15)); /* of two, four, eight, all up to each */
        sums = _mm512_add_epi32(sums, _mm512_alignr_epi32(sums, none, 14));
        sums = _mm512_add_epi32(sums, _mm512_alignr_epi32(sums, none, 12));
        sums = _mm512_add_epi32(sums, _mm512_alignr_epi32(sums, none, 8));
        _mm512_mask_storeu_epi32(numbers + k, these, _mm512_add_epi32(sums, before));
        before = _mm512_add_epi32(before, _mm512_permutexvar_epi32(last, sums)); /* the one sum that waits for the one before */
    }
}
#endif

/* Sort the points by cell; stable within a cell. */
static void scatter(ek_index *index, const ek_real *xy, size_t count)
{
    const size_t cells = (size_t)index->cells.rows * index->cells.columns;
    uint32_t *const EK_RESTRICT next = index->start + 1;
    EK_COUNT(EK_CELLS, cells);
    EK_COUNT(EK_SLOTS, count);
    EK_CALL(index->wide, sum_up, (index->start, cells + 1u));
    for (size_t i = 0; i < count; i++) {
        index->id[next[index->scratch[i]]++] = (uint32_t)i;
    }
    /* point by point in the order of slots: reading in no order waits less than writing in none */
    for (size_t slot = 0; slot < count; slot++) {
        const size_t i = index->id[slot];
        index->xy[2u * slot] = xy[2u * i];
        index->xy[2u * slot + 1u] = xy[2u * i + 1u];
    }
}

/* Points per occupied cell. */
static ek_real density(const ek_index *index, size_t count)
{
    return (ek_real)count / (ek_real)index->occupied;
}

/* 1 if the density is near the target, or above it with the smallest possible cells. */
static int has_target_density(const ek_index *index, size_t count)
{
    const ek_real points = density(index, count);
    return points >= SPARSE && (points <= DENSE || index->cells.finest);
}

ek_status ek_index_build(ek_index *index, const ek_real *xy, size_t count)
{
    ek_bounds span;
    if (!index || (!xy && count)) {
        return EK_NULL_POINTER;
    }
    index->count = 0u;
    index->version++;
    index->normals = index->deferred = NULL;
    index->support = NULL;
    index->seen_from = NULL;
    if (count == 0u || count > index->capacity) {
        return count == 0u ? EK_OK : EK_TOO_MANY_POINTS;
    }
    const ek_status status = ek_bounds_compute(xy, count, index->wide, &span);
    if (status != EK_OK) {
        return status;
    }
    /* start from the last cell width; without one, assume that the points lie along the outline of the box */
    const ek_real width = span.right - span.left, height = span.top - span.bottom;
    ek_real cell = index->cells.cell > EK_R(0.0) ? index->cells.cell : DENSITY * (width + height) / (ek_real)count;
    for (int attempt = 0; attempt < 4; attempt++) {
        if (attempt || !ek_cell_grid_suits(&index->cells, &span)) {
            index->cells = ek_cell_grid_fit(&span, cell, index->cell_capacity);
        }
        count_cells(index, xy, count);
        cell = index->cells.cell * EK_SQRT(DENSITY / density(index, count));
        if (has_target_density(index, count) || (cell > width && cell > height)) {
            break; /* cells wider than the cloud do not help */
        }
    }
    scatter(index, xy, count);
    index->count = count;
    return EK_OK;
}

/* 1 if the grid suits the points: as ek_cell_grid_suits, from occupied cells instead of coordinates. */
static int grid_suits_points(const ek_index *index)
{
    const uint32_t columns = index->cells.columns, rows = index->cells.rows;
    const uint32_t across = ek_cell_grid_spare_lines(columns),
                   up = ek_cell_grid_spare_lines(rows), *const start = index->start;
    if (start[(size_t)up * columns] == 0u || start[(size_t)(rows - up) * columns] == index->count) {
        return 0;
    }
    int left = 0, right = 0;
    EK_COUNT(EK_CELLS, rows);
    for (uint32_t row = 0; row < rows && !(left && right); row++) {
        const uint32_t *const line = start + (size_t)row * columns;
        left |= line[across] > line[0];
        right |= line[columns] > line[columns - across];
    }
    return left && right;
}

int ek_index_is_stable(const ek_index *index)
{
    return has_target_density(index, index->count) && grid_suits_points(index);
}

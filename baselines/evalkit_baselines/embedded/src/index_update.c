#include "ek/index_update.h"
#include "ek/tally.h"

#include <string.h>

#define MAX_COUNT ((size_t)1 << 30)
#define BLOCK EK_INDEX_BLOCK
#define DIGIT_BITS 9u
#define DIGITS ((uint32_t)1 << DIGIT_BITS)

ek_status ek_index_updater_init(ek_index_updater *updater, ek_arena *arena, size_t capacity)
{
    if (!updater || !arena) {
        return EK_NULL_POINTER;
    }
    if (capacity == 0u || capacity > MAX_COUNT) {
        return EK_OUT_OF_RANGE;
    }
    updater->capacity = capacity;
    updater->xy = (ek_real *)ek_arena_alloc(arena, 2u * EK_INDEX_SLOTS(capacity), sizeof(ek_real));
    updater->id = (uint32_t *)ek_arena_alloc(arena, EK_INDEX_SLOTS(capacity), sizeof(uint32_t));
    updater->order = (uint32_t *)ek_arena_alloc(arena, 2u * capacity, sizeof(uint32_t));
    updater->digits = (uint32_t *)ek_arena_alloc(arena, DIGITS + 1u, sizeof(uint32_t));
    return EK_OK;
}

static inline void copy_pair(ek_real *into, size_t to, const ek_real *out_of, size_t from)
{
    memcpy(into + 2u * to, out_of + 2u * from, 2u * sizeof(ek_real));
}

/* One pass of the radix sort: sort `from` into `into` by a digit of the points' cells; stable. */
static void sort_by_digit(uint32_t *digits, const uint32_t *cells, const uint32_t *from, uint32_t *into, uint32_t count,
                    unsigned shift)
{
    EK_COUNT(EK_CELLS, 2u * DIGITS);
    EK_COUNT(EK_SLOTS, 2u * count);
    memset(digits, 0, (DIGITS + 1u) * sizeof(uint32_t));
    for (uint32_t i = 0; i < count; i++) {
        digits[(cells[i] >> shift & (DIGITS - 1u)) + 1u]++;
    }
    for (uint32_t digit = 1; digit < DIGITS; digit++) {
        digits[digit] += digits[digit - 1u];
    }
    for (uint32_t i = 0; i < count; i++) {
        into[digits[cells[from[i]] >> shift & (DIGITS - 1u)]++] = from[i];
    }
}

/* Sort the new points by cell (stable); *order and *cells point into updater->order. */
static void sort_by_cell(ek_index_updater *updater, const ek_index *index, const ek_real *xy, uint32_t count,
                         uint32_t **order, uint32_t **cells)
{
    const uint64_t last = (uint64_t)index->cells.rows * index->cells.columns - 1u; /* wider than any shift */
    EK_COUNT(EK_SLOTS, 2u * count);
    uint32_t *sorted = updater->order, *other = updater->order + updater->capacity;
    for (uint32_t i = 0; i < count; i++) {
        index->scratch[i] = ek_cell_grid_index(&index->cells, xy + 2u * (size_t)i);
        sorted[i] = i;
    }
    for (unsigned shift = 0; last >> shift; shift += DIGIT_BITS) { /* least significant digit first */
        sort_by_digit(updater->digits, index->scratch, sorted, other, count, shift);
        uint32_t *const swap = sorted;
        sorted = other;
        other = swap;
    }
    for (uint32_t j = 0; j < count; j++) {
        other[j] = index->scratch[sorted[j]];
    }
    *order = sorted;
    *cells = other;
}

/* Count in `before` how many new points go in front of each slot. */
static void count_insertions(ek_index *index, const uint32_t *cells, uint32_t count, uint32_t *before)
{
    const uint32_t *const start = index->start;
    uint32_t last = EK_NONE;
    EK_COUNT(EK_SLOTS, index->count + count);
    memset(before, 0, (index->count + 1u) * sizeof(uint32_t));
    for (uint32_t j = 0; j < count; j++) {
        const uint32_t cell = cells[j], end = start[cell + 1u];
        index->occupied += cell != last && start[cell] == end;
        before[end]++;
        last = cell;
    }
}

/* Copy the slots that stay to their new positions. On entry `gone` holds the counts of count_insertions; on return, the
 * slots of removed points (an entry is read before it is overwritten). Without a branch: a removed point is written too
 * and then overwritten, or ends one slot behind the last. */
static void copy_kept_slots(ek_index_updater *updater, const ek_index *index, uint32_t removed, uint32_t *gone)
{
    const ek_real *const EK_RESTRICT xy = index->xy;
    const uint32_t *const EK_RESTRICT id = index->id;
    ek_real *const EK_RESTRICT new_xy = updater->xy;
    uint32_t *const EK_RESTRICT new_id = updater->id;
    const size_t count = index->count;
    size_t written = 0u, met = 0u;
    EK_COUNT(EK_SLOTS, count);
    for (size_t k = 0; k < count; k++) {
        const uint32_t now = id[k] - removed, leaves = id[k] < removed;
        written += gone[k];
        copy_pair(new_xy, written, xy, k);
        new_id[written] = now;
        gone[met] = (uint32_t)k;
        written += 1u - leaves;
        met += leaves;
    }
}

/* Shift the entries of a block by the changes in the cells before them; returns the shift behind the block. */
static uint32_t shift_block(uint32_t *EK_RESTRICT start, uint32_t *EK_RESTRICT change, uint32_t by)
{
    for (uint32_t k = 0; k < BLOCK; k++) {
        by += change[k];
        start[k] += by;
        change[k] = 0u;
    }
    return by;
}

/* Shift the start of every cell by the points added and removed before it; `added_cells` and `removed_cells` are
 * sorted. Most blocks contain no such cell. */
static void shift_starts(ek_index *index, const uint32_t *added_cells, uint32_t count, const uint32_t *removed_cells,
                         uint32_t removed)
{
    const uint32_t entries = index->cells.rows * index->cells.columns + 1u;
    EK_COUNT(EK_CELLS, entries + BLOCK);
    uint32_t change[BLOCK] = {0u}, i = 0u, j = 0u, by = 0u;
    for (uint32_t block = 0; block < entries; block += BLOCK) {
        uint32_t *const start = index->start + block;
        const uint32_t before = i + j, last = block + BLOCK - 1u; /* a change in cell k shifts entry k + 1 */
        for (; i < count && added_cells[i] < last; i++) {
            change[added_cells[i] + 1u - block]++;
        }
        for (; j < removed && removed_cells[j] < last; j++) {
            change[removed_cells[j] + 1u - block]--;
        }
        if (i + j > before) {
            by = shift_block(start, change, by);
            continue;
        }
        for (uint32_t k = 0; k < BLOCK; k++) {
            start[k] += by;
        }
    }
}

/* Insert the new points behind the other points of their cells. */
static void insert_points(ek_index_updater *updater, const ek_index *index, uint32_t kept, const ek_real *xy,
                          const uint32_t *order, const uint32_t *cells, uint32_t count)
{
    uint32_t slot = 0u, last = EK_NONE;
    EK_COUNT(EK_SLOTS, count);
    for (uint32_t j = count; j-- > 0u;) {
        slot = (cells[j] == last ? slot : index->start[cells[j] + 1u]) - 1u;
        last = cells[j];
        copy_pair(updater->xy, slot, xy, order[j]);
        updater->id[slot] = kept + order[j];
    }
}

static void swap_arrays(ek_index_updater *updater, ek_index *index)
{
    ek_real *const xy = index->xy;
    uint32_t *const id = index->id;
    index->xy = updater->xy;
    index->id = updater->id;
    updater->xy = xy;
    updater->id = id;
}

/* Update the slots without changing the cells; all new points lie inside the grid. */
static void update_in_place(ek_index_updater *updater, ek_index *index, uint32_t removed, const ek_real *xy,
                            uint32_t count)
{
    const uint32_t kept = (uint32_t)index->count - removed;
    uint32_t *order, *cells, *const gone = index->scratch, last = EK_NONE;
    EK_COUNT(EK_SLOTS, 2u * removed);
    sort_by_cell(updater, index, xy, count, &order, &cells);
    count_insertions(index, cells, count, gone);
    copy_kept_slots(updater, index, removed, gone);
    for (uint32_t k = 0; k < removed; k++) { /* replace slots by cells */
        gone[k] = ek_cell_grid_index(&index->cells, index->xy + 2u * (size_t)gone[k]);
    }
    shift_starts(index, cells, count, gone, removed);
    insert_points(updater, index, kept, xy, order, cells, count);
    for (uint32_t k = 0; k < removed; k++) {
        index->occupied -= gone[k] != last && index->start[gone[k]] == index->start[gone[k] + 1u];
        last = gone[k];
    }
    swap_arrays(updater, index);
    index->count = (size_t)kept + count;
    index->version++;
    index->normals = index->deferred = NULL;
    index->support = NULL;
    index->seen_from = NULL;
}

/* Build the index again from the remaining points and the new ones. */
static ek_status rebuild(ek_index_updater *updater, ek_index *index, size_t removed, const ek_real *xy, size_t count)
{
    const size_t kept = index->count - removed;
    EK_COUNT(EK_SLOTS, index->count + count);
    for (size_t k = 0; k < index->count; k++) {
        if (index->id[k] >= removed) {
            copy_pair(updater->xy, index->id[k] - removed, index->xy, k);
        }
    }
    if (count) {
        memcpy(updater->xy + 2u * kept, xy, 2u * count * sizeof(ek_real));
    }
    return ek_index_build(index, updater->xy, kept + count);
}

ek_status ek_index_update(ek_index_updater *updater, ek_index *index, size_t removed, const ek_real *xy, size_t count)
{
    ek_bounds span;
    if (!updater || !index || (!xy && count)) {
        return EK_NULL_POINTER;
    }
    if (removed > index->count || updater->capacity != index->capacity) {
        return EK_OUT_OF_RANGE;
    }
    if (count > index->capacity - (index->count - removed)) {
        return EK_TOO_MANY_POINTS;
    }
    const ek_status status = ek_bounds_compute(xy, count, index->wide, &span);
    if (status != EK_OK) {
        return status;
    }
    if (removed == index->count) {
        return ek_index_build(index, xy, count);
    }
    if (count && !ek_cell_grid_contains(&index->cells, &span)) {
        return rebuild(updater, index, removed, xy, count);
    }
    update_in_place(updater, index, (uint32_t)removed, xy, (uint32_t)count);
    return ek_index_is_stable(index) ? EK_OK : rebuild(updater, index, 0u, NULL, 0u);
}

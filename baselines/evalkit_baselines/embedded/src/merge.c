#include "ek/merge.h"

#include <string.h>

#define MOST ((size_t)1 << 30)
#define BLOCK EK_INDEX_BLOCK
#define DIGIT_BITS 9u
#define DIGITS ((uint32_t)1 << DIGIT_BITS)

ek_status ek_merge_lay_out(ek_merge *merge, ek_arena *arena, size_t capacity)
{
    if (!merge || !arena) {
        return EK_NULL_POINTER;
    }
    if (capacity == 0u || capacity > MOST) {
        return EK_OUT_OF_RANGE;
    }
    merge->capacity = capacity;
    merge->xy = (ek_real *)ek_arena_take(arena, 2u * EK_INDEX_SLOTS(capacity), sizeof(ek_real));
    merge->id = (uint32_t *)ek_arena_take(arena, EK_INDEX_SLOTS(capacity), sizeof(uint32_t));
    merge->order = (uint32_t *)ek_arena_take(arena, 2u * capacity, sizeof(uint32_t));
    merge->digits = (uint32_t *)ek_arena_take(arena, DIGITS + 1u, sizeof(uint32_t));
    return EK_OK;
}

static inline void copy_pair(ek_real *into, size_t to, const ek_real *out_of, size_t from)
{
    memcpy(into + 2u * to, out_of + 2u * from, 2u * sizeof(ek_real));
}

/* Sorts `from` into `into` by a digit of the points' cells; equal ones keep their order. */
static void sort_by(uint32_t *digits, const uint32_t *cells, const uint32_t *from, uint32_t *into, uint32_t count,
                    unsigned shift)
{
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

/* The new points by their cells, in one cell as they came, and these cells in the same order: both in merge->order. */
static void sort(ek_merge *merge, const ek_index *index, const ek_real *xy, uint32_t count, uint32_t **order,
                 uint32_t **cells)
{
    const uint32_t last = index->frame.rows * index->frame.columns - 1u;
    uint32_t *sorted = merge->order, *other = merge->order + merge->capacity;
    for (uint32_t i = 0; i < count; i++) {
        index->scratch[i] = ek_frame_cell(&index->frame, xy + 2u * (size_t)i);
        sorted[i] = i;
    }
    for (unsigned shift = 0; shift < 32u && last >> shift; shift += DIGIT_BITS) { /* the lowest digit first */
        sort_by(merge->digits, index->scratch, sorted, other, count, shift);
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

/* Counts in `before` the new points that will come between each slot and the one before it. */
static void make_room(ek_index *index, const uint32_t *cells, uint32_t count, uint32_t *before)
{
    const uint32_t *const start = index->start;
    uint32_t last = EK_NONE;
    memset(before, 0, (index->count + 1u) * sizeof(uint32_t));
    for (uint32_t j = 0; j < count; j++) {
        const uint32_t cell = cells[j], end = start[cell + 1u];
        index->occupied += cell != last && start[cell] == end;
        before[end]++;
        last = cell;
    }
}

/* Copies the slots that stay to where they will stand. The slots of points below `removed` are noted in `gone`, which
 * on entry holds what `make_room` counted: what is written over has been read. No branch: what leaves is written too,
 * and overwritten, or lies one slot behind the last. */
static void take_over(ek_merge *merge, const ek_index *index, uint32_t removed, uint32_t *gone)
{
    const ek_real *const EK_RESTRICT xy = index->xy;
    const uint32_t *const EK_RESTRICT id = index->id;
    ek_real *const EK_RESTRICT new_xy = merge->xy;
    uint32_t *const EK_RESTRICT new_id = merge->id;
    const size_t count = index->count;
    size_t written = 0u, met = 0u;
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

/* Adds to each entry of a block what came and went in the cells before it; says how much that is behind the block. */
static uint32_t shift_block(uint32_t *EK_RESTRICT start, uint32_t *EK_RESTRICT change, uint32_t by)
{
    for (uint32_t k = 0; k < BLOCK; k++) {
        by += change[k];
        start[k] += by;
        change[k] = 0u;
    }
    return by;
}

/* Moves the start of every cell by the points that came and went before it: `came` and `went` are their cells in order.
 * Most blocks hold no such cell. */
static void shift(ek_index *index, const uint32_t *came, uint32_t count, const uint32_t *went, uint32_t removed)
{
    const uint32_t entries = index->frame.rows * index->frame.columns + 1u;
    uint32_t change[BLOCK] = {0u}, i = 0u, j = 0u, by = 0u;
    for (uint32_t block = 0; block < entries; block += BLOCK) {
        uint32_t *const start = index->start + block;
        const uint32_t before = i + j, last = block + BLOCK - 1u; /* what lies in cell k moves entry k + 1 */
        for (; i < count && came[i] < last; i++) {
            change[came[i] + 1u - block]++;
        }
        for (; j < removed && went[j] < last; j++) {
            change[went[j] + 1u - block]--;
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

/* Puts the new points behind the others of their cells. */
static void put(ek_merge *merge, const ek_index *index, uint32_t kept, const ek_real *xy, const uint32_t *order,
                const uint32_t *cells, uint32_t count)
{
    uint32_t slot = 0u, last = EK_NONE;
    for (uint32_t j = count; j-- > 0u;) {
        slot = (cells[j] == last ? slot : index->start[cells[j] + 1u]) - 1u;
        last = cells[j];
        copy_pair(merge->xy, slot, xy, order[j]);
        merge->id[slot] = kept + order[j];
    }
}

static void swap(ek_merge *merge, ek_index *index)
{
    ek_real *const xy = index->xy;
    uint32_t *const id = index->id;
    index->xy = merge->xy;
    index->id = merge->id;
    merge->xy = xy;
    merge->id = id;
}

/* Brings the slots up to date among the cells there are; all new points lie in them. */
static void patch(ek_merge *merge, ek_index *index, uint32_t removed, const ek_real *xy, uint32_t count)
{
    const uint32_t kept = (uint32_t)index->count - removed;
    uint32_t *order, *cells, *const gone = index->scratch, last = EK_NONE;
    sort(merge, index, xy, count, &order, &cells);
    make_room(index, cells, count, gone);
    take_over(merge, index, removed, gone);
    for (uint32_t k = 0; k < removed; k++) { /* slots become cells */
        gone[k] = ek_frame_cell(&index->frame, index->xy + 2u * (size_t)gone[k]);
    }
    shift(index, cells, count, gone, removed);
    put(merge, index, kept, xy, order, cells, count);
    for (uint32_t k = 0; k < removed; k++) {
        index->occupied -= gone[k] != last && index->start[gone[k]] == index->start[gone[k] + 1u];
        last = gone[k];
    }
    swap(merge, index);
    index->count = (size_t)kept + count;
}

/* Builds from the points held, but for the first ones, and new ones. */
static ek_status rebuild(ek_merge *merge, ek_index *index, size_t removed, const ek_real *xy, size_t count)
{
    const size_t kept = index->count - removed;
    for (size_t k = 0; k < index->count; k++) {
        if (index->id[k] >= removed) {
            copy_pair(merge->xy, index->id[k] - removed, index->xy, k);
        }
    }
    if (count) {
        memcpy(merge->xy + 2u * kept, xy, 2u * count * sizeof(ek_real));
    }
    return ek_index_build(index, merge->xy, kept + count);
}

ek_status ek_merge_update(ek_merge *merge, ek_index *index, size_t removed, const ek_real *xy, size_t count)
{
    ek_span span;
    if (!merge || !index || (!xy && count)) {
        return EK_NULL_POINTER;
    }
    if (removed > index->count || merge->capacity != index->capacity) {
        return EK_OUT_OF_RANGE;
    }
    if (count > index->capacity - (index->count - removed)) {
        return EK_TOO_MANY_POINTS;
    }
    const ek_status status = ek_span_of(xy, count, &span);
    if (status != EK_OK) {
        return status;
    }
    if (removed == index->count) {
        return ek_index_build(index, xy, count);
    }
    if (count && !ek_frame_holds(&index->frame, &span)) {
        return rebuild(merge, index, removed, xy, count);
    }
    patch(merge, index, (uint32_t)removed, xy, (uint32_t)count);
    return ek_index_settled(index) ? EK_OK : rebuild(merge, index, 0u, NULL, 0u);
}

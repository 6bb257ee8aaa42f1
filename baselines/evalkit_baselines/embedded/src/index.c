#include "ek/index.h"

#include <string.h>

#define MOST ((size_t)1 << 30)
#define DENSITY EK_R(3.0) /* points per occupied cell to aim at */
#define SPARSE (EK_R(0.6) * DENSITY)
#define DENSE (EK_R(1.7) * DENSITY)

ek_status ek_index_lay_out(ek_index *index, ek_arena *arena, size_t capacity, size_t cells)
{
    if (!index || !arena) {
        return EK_NULL_POINTER;
    }
    if (capacity == 0u || cells == 0u || capacity > MOST || cells > MOST) {
        return EK_OUT_OF_RANGE;
    }
    memset(index, 0, sizeof *index);
    index->capacity = capacity;
    index->cell_capacity = cells;
    index->xy = (ek_real *)ek_arena_take(arena, 2u * EK_INDEX_SLOTS(capacity), sizeof(ek_real));
    index->id = (uint32_t *)ek_arena_take(arena, EK_INDEX_SLOTS(capacity), sizeof(uint32_t));
    index->start = (uint32_t *)ek_arena_take(arena, cells + 2u + EK_INDEX_BLOCK, sizeof(uint32_t));
    index->scratch = (uint32_t *)ek_arena_take(arena, EK_INDEX_SLOTS(capacity), sizeof(uint32_t));
    if (arena->memory && ek_arena_check(arena) == EK_OK) {
        memset(index->start, 0, (cells + 2u + EK_INDEX_BLOCK) * sizeof(uint32_t));
    }
    return EK_OK;
}

/* Counts the points of each cell, one entry late, and the cells that hold any. */
static void tally(ek_index *index, const ek_real *xy, size_t count)
{
    const ek_frame frame = index->frame;
    uint32_t *const EK_RESTRICT counts = index->start + 2;
    uint32_t *const EK_RESTRICT cells = index->scratch;
    size_t occupied = 0u;
    memset(index->start, 0, ((size_t)frame.rows * frame.columns + 2u) * sizeof(uint32_t));
    for (size_t i = 0; i < count; i++) {
        const uint32_t cell = ek_frame_cell(&frame, xy + 2u * i);
        cells[i] = cell;
        occupied += counts[cell]++ == 0u;
    }
    index->occupied = occupied;
}

/* Sorts the points by cell; within a cell they keep their order. */
static void scatter(ek_index *index, const ek_real *xy, size_t count)
{
    const size_t cells = (size_t)index->frame.rows * index->frame.columns;
    uint32_t *const EK_RESTRICT next = index->start + 1;
    for (size_t cell = 1; cell <= cells; cell++) {
        index->start[cell] += index->start[cell - 1u];
    }
    for (size_t i = 0; i < count; i++) {
        const uint32_t slot = next[index->scratch[i]]++;
        index->xy[2u * slot] = xy[2u * i];
        index->xy[2u * slot + 1u] = xy[2u * i + 1u];
        index->id[slot] = (uint32_t)i;
    }
}

/* Points per occupied cell. */
static ek_real density(const ek_index *index, size_t count)
{
    return (ek_real)count / (ek_real)index->occupied;
}

/* Whether cells hold about as many points as they should, or more because there can be no finer ones. */
static int filled(const ek_index *index, size_t count)
{
    const ek_real points = density(index, count);
    return points >= SPARSE && (points <= DENSE || index->frame.finest);
}

ek_status ek_index_build(ek_index *index, const ek_real *xy, size_t count)
{
    ek_span span;
    if (!index || (!xy && count)) {
        return EK_NULL_POINTER;
    }
    index->count = 0u;
    if (count == 0u || count > index->capacity) {
        return count == 0u ? EK_OK : EK_TOO_MANY_POINTS;
    }
    const ek_status status = ek_span_of(xy, count, &span);
    if (status != EK_OK) {
        return status;
    }
    /* the last cloud's cells are a good first guess; without: points along the outline of the box */
    const ek_real width = span.right - span.left, height = span.top - span.bottom;
    ek_real cell = index->frame.cell > EK_R(0.0) ? index->frame.cell : DENSITY * (width + height) / (ek_real)count;
    for (int attempt = 0; attempt < 4; attempt++) {
        if (attempt || !ek_frame_suits(&index->frame, &span)) {
            index->frame = ek_frame_over(&span, cell, index->cell_capacity);
        }
        tally(index, xy, count);
        cell = index->frame.cell * EK_SQRT(DENSITY / density(index, count));
        if (filled(index, count) || (cell > width && cell > height)) {
            break; /* cells wider than the cloud gain nothing */
        }
    }
    scatter(index, xy, count);
    index->count = count;
    return EK_OK;
}

/* Whether the frame suits the points held, told by their cells: what ek_frame_suits tells by their coordinates. */
static int suits(const ek_index *index)
{
    const uint32_t columns = index->frame.columns, rows = index->frame.rows;
    const uint32_t across = ek_frame_spare(columns), up = ek_frame_spare(rows), *const start = index->start;
    if (start[(size_t)up * columns] == 0u || start[(size_t)(rows - up) * columns] == index->count) {
        return 0;
    }
    int left = 0, right = 0;
    for (uint32_t row = 0; row < rows && !(left && right); row++) {
        const uint32_t *const line = start + (size_t)row * columns;
        left |= line[across] > line[0];
        right |= line[columns] > line[columns - across];
    }
    return left && right;
}

int ek_index_settled(const ek_index *index)
{
    return filled(index, index->count) && suits(index);
}

/* Squared distances (m^2) of the best and the second best candidate so far. */
typedef struct {
    ek_real best, second;
    uint32_t slot;
} candidates;

/* Looks at the slots [from, to). */
static inline void look(const ek_index *index, uint32_t from, uint32_t to, ek_real x, ek_real y, candidates *found)
{
    const ek_real *const EK_RESTRICT xy = index->xy;
    ek_real best = found->best, second = found->second;
    uint32_t slot = found->slot;
    for (uint32_t k = from; k < to; k++) {
        const ek_real dx = xy[2u * k] - x, dy = xy[2u * k + 1u] - y, squared = dx * dx + dy * dy;
        const ek_real worse = squared > best ? squared : best;
        second = worse < second ? worse : second;
        slot = squared < best ? k : slot;
        best = squared < best ? squared : best;
    }
    found->best = best;
    found->second = second;
    found->slot = slot;
}

/* Of the slots in a block of cells that are exactly as near as the best, the one with the lowest index. */
static uint32_t lowest(const ek_index *index, int32_t box[4], ek_real x, ek_real y, ek_real best)
{
    uint32_t slot = EK_NONE;
    for (int32_t row = box[2]; row <= box[3]; row++) {
        const uint32_t base = (uint32_t)row * index->frame.columns;
        const uint32_t to = index->start[base + (uint32_t)box[1] + 1u];
        for (uint32_t k = index->start[base + (uint32_t)box[0]]; k < to; k++) {
            const ek_real dx = index->xy[2u * k] - x, dy = index->xy[2u * k + 1u] - y;
            if (dx * dx + dy * dy <= best && (slot == EK_NONE || index->id[k] < index->id[slot])) {
                slot = k;
            }
        }
    }
    return slot;
}

/* The cell number of a place along one axis, in cells, or that of the nearest cell there is. */
static inline int32_t cell_of(ek_real place, int32_t last)
{
    const ek_real within = place > EK_R(0.0) ? place : EK_R(0.0);
    return within < (ek_real)last ? (int32_t)within : last;
}

/* Searches all cells that a square of half a side `radius` (m) around a place touches; fills box with their columns and
 * rows and gives the distance (m) below which nothing outside of them lies, to within rounding (`margin`). */
static inline ek_real search(const ek_index *index, ek_real x, ek_real y, ek_real radius, ek_real margin,
                             int32_t box[4], candidates *found)
{
    const ek_frame *const frame = &index->frame;
    const ek_real column = (x - frame->left) * frame->per_cell, row = (y - frame->bottom) * frame->per_cell;
    const ek_real reach = radius * frame->per_cell;
    const int32_t last_column = (int32_t)frame->columns - 1, last_row = (int32_t)frame->rows - 1;
    box[0] = cell_of(column - reach, last_column);
    box[1] = cell_of(column + reach, last_column);
    box[2] = cell_of(row - reach, last_row);
    box[3] = cell_of(row + reach, last_row);
    found->best = found->second = EK_FAR * EK_FAR;
    found->slot = EK_NONE;
    const uint32_t *start = index->start + (size_t)box[2] * frame->columns;
    for (int32_t line = box[2]; line <= box[3]; line++, start += frame->columns) {
        look(index, start[box[0]], start[box[1] + 1], x, y, found);
    }
    const int all = box[0] == 0 && box[2] == 0 && box[1] == last_column && box[3] == last_row;
    return all ? EK_FAR : radius - margin;
}

ek_neighbour ek_index_nearest(const ek_index *index, ek_real x, ek_real y, ek_real limit, ek_real radius)
{
    ek_neighbour answer = {EK_NONE, EK_FAR, EK_FAR};
    if (index->count == 0u) {
        return answer;
    }
    candidates found;
    int32_t box[4];
    /* far from the points rounding does more than among them; without this the search would not end there */
    const ek_real margin = index->frame.margin + EK_R(16.0) * EK_EPSILON * (EK_FABS(x) + EK_FABS(y));
    ek_real border = search(index, x, y, radius, margin, box, &found), best = EK_SQRT(found.best);
    while (border <= best && border < limit) {
        const ek_real needed = (best < limit ? best : limit) + EK_R(4.0) * margin;
        radius = needed < EK_R(2.0) * radius ? needed : EK_R(2.0) * radius;
        border = search(index, x, y, radius, margin, box, &found);
        best = EK_SQRT(found.best);
    }
    const ek_real second = EK_SQRT(found.second);
    if (best < limit) {
        answer.slot = found.second > found.best ? found.slot : lowest(index, box, x, y, found.best);
        answer.distance = best;
        answer.others = second < border ? second : border;
    } else {
        answer.others = best < border ? best : border;
    }
    return answer;
}

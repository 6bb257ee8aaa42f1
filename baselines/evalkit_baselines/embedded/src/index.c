#include "ek/index.h"

#include <string.h>

#define MOST ((size_t)1 << 30)
#define MOST_ACROSS EK_R(1048576) /* cells: a float still tells them apart */
#define DENSITY EK_R(3.0) /* points per occupied cell to aim at */
#define LEAST_CELL EK_R(1e-3) /* m */

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
    index->x = (ek_real *)ek_arena_take(arena, capacity, sizeof(ek_real));
    index->y = (ek_real *)ek_arena_take(arena, capacity, sizeof(ek_real));
    index->id = (uint32_t *)ek_arena_take(arena, capacity, sizeof(uint32_t));
    index->start = (uint32_t *)ek_arena_take(arena, cells + 2u, sizeof(uint32_t));
    index->scratch = (uint32_t *)ek_arena_take(arena, capacity, sizeof(uint32_t));
    if (arena->memory && ek_arena_check(arena) == EK_OK) {
        memset(index->start, 0, (cells + 2u) * sizeof(uint32_t));
    }
    return EK_OK;
}

/* The corner and size (m) of the box around a cloud. */
static ek_status bound(ek_index *index, const ek_real *xy, size_t count, ek_real *width, ek_real *height)
{
    ek_real left = EK_LARGEST, right = -EK_LARGEST, bottom = EK_LARGEST, top = -EK_LARGEST;
    for (size_t i = 0; i < count; i++) {
        const ek_real x = xy[2u * i], y = xy[2u * i + 1u];
        if (!(EK_FABS(x) <= EK_LARGEST && EK_FABS(y) <= EK_LARGEST)) {
            return isfinite(x) && isfinite(y) ? EK_OUT_OF_RANGE : EK_NOT_FINITE;
        }
        left = x < left ? x : left;
        right = x > right ? x : right;
        bottom = y < bottom ? y : bottom;
        top = y > top ? y : top;
    }
    const ek_real far_x = EK_FABS(left) > EK_FABS(right) ? EK_FABS(left) : EK_FABS(right);
    const ek_real far_y = EK_FABS(bottom) > EK_FABS(top) ? EK_FABS(bottom) : EK_FABS(top);
    index->left = left;
    index->bottom = bottom;
    index->margin = EK_R(16.0) * EK_EPSILON * (EK_R(1.0) + far_x + far_y);
    *width = right - left;
    *height = top - bottom;
    return EK_OK;
}

/* Chooses the cells of a given width, or the next wider ones that fit the capacity. */
static void divide(ek_index *index, ek_real cell, ek_real width, ek_real height)
{
    const ek_real most = (ek_real)index->cell_capacity;
    for (;;) {
        const ek_real columns = EK_FLOOR(width / cell) + EK_R(1.0), rows = EK_FLOOR(height / cell) + EK_R(1.0);
        if (columns <= MOST_ACROSS && rows <= MOST_ACROSS && columns * rows <= most) {
            index->columns = (uint32_t)columns;
            index->rows = (uint32_t)rows;
            index->cell = cell;
            index->per_cell = EK_R(1.0) / cell;
            return;
        }
        cell *= EK_R(1.1);
    }
}

/* Counts the points of each cell, one entry late, and says how many cells hold any. */
static size_t tally(ek_index *index, const ek_real *xy, size_t count)
{
    const ek_real left = index->left, bottom = index->bottom, per_cell = index->per_cell;
    const uint32_t last_column = index->columns - 1u, last_row = index->rows - 1u, columns = index->columns;
    uint32_t *const EK_RESTRICT counts = index->start + 2;
    size_t occupied = 0u;
    memset(index->start, 0, ((size_t)index->rows * columns + 2u) * sizeof(uint32_t));
    for (size_t i = 0; i < count; i++) {
        /* bound() has shown all coordinates finite and inside the box: the casts are safe */
        uint32_t column = (uint32_t)(int32_t)((xy[2u * i] - left) * per_cell);
        uint32_t row = (uint32_t)(int32_t)((xy[2u * i + 1u] - bottom) * per_cell);
        column = column > last_column ? last_column : column;
        row = row > last_row ? last_row : row;
        const uint32_t cell = row * columns + column;
        index->scratch[i] = cell;
        occupied += counts[cell]++ == 0u;
    }
    return occupied;
}

/* Sorts the points by cell; within a cell they keep their order. */
static void scatter(ek_index *index, const ek_real *xy, size_t count)
{
    const size_t cells = (size_t)index->rows * index->columns;
    uint32_t *const EK_RESTRICT next = index->start + 1;
    for (size_t cell = 1; cell <= cells; cell++) {
        index->start[cell] += index->start[cell - 1u];
    }
    for (size_t i = 0; i < count; i++) {
        const uint32_t slot = next[index->scratch[i]]++;
        index->x[slot] = xy[2u * i];
        index->y[slot] = xy[2u * i + 1u];
        index->id[slot] = (uint32_t)i;
    }
}

ek_status ek_index_build(ek_index *index, const ek_real *xy, size_t count)
{
    ek_real width, height;
    if (!index || (!xy && count)) {
        return EK_NULL_POINTER;
    }
    index->count = 0u;
    if (count == 0u || count > index->capacity) {
        return count == 0u ? EK_OK : EK_TOO_MANY_POINTS;
    }
    const ek_status status = bound(index, xy, count, &width, &height);
    if (status != EK_OK) {
        return status;
    }
    /* the last cloud's cell is a good first guess; without one: points along the outline of the box */
    ek_real cell = index->cell > EK_R(0.0) ? index->cell : DENSITY * (width + height) / (ek_real)count;
    for (int attempt = 0; attempt < 4; attempt++) {
        cell = cell > LEAST_CELL ? cell : LEAST_CELL;
        divide(index, cell, width, height);
        const ek_real density = (ek_real)count / (ek_real)tally(index, xy, count);
        const int sparse = density < EK_R(0.6) * DENSITY, dense = density > EK_R(1.7) * DENSITY;
        if (!sparse && !dense) {
            break;
        }
        const ek_real wanted = index->cell * EK_SQRT(DENSITY / density);
        if ((dense && index->cell > cell) || attempt == 3 || (sparse && wanted > width && wanted > height)) {
            break; /* no room for finer cells, nothing to gain from wider ones, or no end */
        }
        cell = wanted;
    }
    scatter(index, xy, count);
    index->count = count;
    return EK_OK;
}

/* Squared distances (m^2) of the best and the second best candidate so far. */
typedef struct {
    ek_real best, second;
    uint32_t slot;
} candidates;

/* Looks at the slots [from, to). */
static inline void look(const ek_index *index, uint32_t from, uint32_t to, ek_real x, ek_real y, candidates *found)
{
    const ek_real *const EK_RESTRICT xs = index->x, *const EK_RESTRICT ys = index->y;
    ek_real best = found->best, second = found->second;
    uint32_t slot = found->slot;
    for (uint32_t k = from; k < to; k++) {
        const ek_real dx = xs[k] - x, dy = ys[k] - y, squared = dx * dx + dy * dy;
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
        const uint32_t base = (uint32_t)row * index->columns;
        const uint32_t to = index->start[base + (uint32_t)box[1] + 1u];
        for (uint32_t k = index->start[base + (uint32_t)box[0]]; k < to; k++) {
            const ek_real dx = index->x[k] - x, dy = index->y[k] - y;
            if (dx * dx + dy * dy <= best && (slot == EK_NONE || index->id[k] < index->id[slot])) {
                slot = k;
            }
        }
    }
    return slot;
}

static int32_t clamped(int32_t value, int32_t high)
{
    return value < 0 ? 0 : value > high ? high : value;
}

/* Searches the (2 reach + 1)^2 cells around a cell; fills box with their columns and rows and gives the distance (m)
 * below which nothing outside of them lies. column and row are in cells, floats; reach and cell numbers stay < 2^23. */
static ek_real search(const ek_index *index, ek_real x, ek_real y, int32_t reach, int32_t box[4], candidates *found)
{
    const ek_real column = (x - index->left) * index->per_cell, row = (y - index->bottom) * index->per_cell;
    const int32_t last_column = (int32_t)index->columns - 1, last_row = (int32_t)index->rows - 1;
    const int32_t c = column < EK_R(0.0) ? -1 : column > (ek_real)last_column ? last_column : (int32_t)column;
    const int32_t r = row < EK_R(0.0) ? -1 : row > (ek_real)last_row ? last_row : (int32_t)row;
    ek_real border = EK_FAR;
    found->best = found->second = EK_FAR * EK_FAR;
    found->slot = EK_NONE;
    const ek_real gaps[4] = {
        c - reach > 0 ? column - (ek_real)(c - reach) : EK_FAR,
        c + reach < last_column ? (ek_real)(c + reach + 1) - column : EK_FAR,
        r - reach > 0 ? row - (ek_real)(r - reach) : EK_FAR,
        r + reach < last_row ? (ek_real)(r + reach + 1) - row : EK_FAR,
    };
    for (int side = 0; side < 4; side++) {
        border = gaps[side] < border ? gaps[side] : border;
    }
    box[0] = clamped(c - reach, last_column);
    box[1] = clamped(c + reach, last_column);
    box[2] = clamped(r - reach, last_row);
    box[3] = clamped(r + reach, last_row);
    for (int32_t line = box[2]; line <= box[3]; line++) {
        const uint32_t base = (uint32_t)line * index->columns;
        look(index, index->start[base + (uint32_t)box[0]], index->start[base + (uint32_t)box[1] + 1u], x, y, found);
    }
    return border * index->cell - index->margin;
}

/* The next reach to try when the answer may lie `needed` cells away. */
static int32_t wider(int32_t reach, ek_real needed)
{
    const int32_t enough = needed < (ek_real)(2 * reach) ? (int32_t)needed + 1 : 2 * reach;
    return enough > reach ? enough : reach + 1;
}

/* search() with reach 1 for a place well inside of the grid, where nothing needs clamping; less than 0 elsewhere. */
static inline ek_real search_nine(const ek_index *index, ek_real x, ek_real y, int32_t box[4], candidates *found)
{
    const ek_real column = (x - index->left) * index->per_cell, row = (y - index->bottom) * index->per_cell;
    const uint32_t columns = index->columns;
    if (!(column >= EK_R(1.0) && row >= EK_R(1.0) && column < (ek_real)columns - EK_R(1.0) &&
          row < (ek_real)index->rows - EK_R(1.0))) {
        return EK_R(-1.0);
    }
    const int32_t c = (int32_t)column, r = (int32_t)row;
    const uint32_t *const start = index->start + (size_t)(r - 1) * columns + (size_t)(c - 1);
    const ek_real u = column - (ek_real)c, v = row - (ek_real)r;
    const ek_real near_u = u < EK_R(1.0) - u ? u : EK_R(1.0) - u, near_v = v < EK_R(1.0) - v ? v : EK_R(1.0) - v;
    found->best = found->second = EK_FAR * EK_FAR;
    found->slot = EK_NONE;
    look(index, start[0], start[3], x, y, found);
    look(index, start[columns], start[columns + 3u], x, y, found);
    look(index, start[2u * columns], start[2u * columns + 3u], x, y, found);
    box[0] = c - 1;
    box[1] = c + 1;
    box[2] = r - 1;
    box[3] = r + 1;
    return (EK_R(1.0) + (near_u < near_v ? near_u : near_v)) * index->cell - index->margin;
}

ek_neighbour ek_index_nearest(const ek_index *index, ek_real x, ek_real y, ek_real limit)
{
    ek_neighbour answer = {EK_NONE, EK_FAR, EK_FAR};
    if (index->count == 0u) {
        return answer;
    }
    const int32_t widest = (int32_t)(index->columns > index->rows ? index->columns : index->rows);
    candidates found;
    int32_t box[4], reach = 1;
    ek_real border = search_nine(index, x, y, box, &found);
    if (border < EK_R(0.0)) {
        border = search(index, x, y, reach, box, &found);
    }
    ek_real best = EK_SQRT(found.best);
    while (border < best && border < limit && reach < widest) {
        reach = wider(reach, (best < limit ? best : limit) * index->per_cell);
        border = search(index, x, y, reach, box, &found);
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

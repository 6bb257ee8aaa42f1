#include "ek/table.h"

#include <string.h>

#define MAX_COUNT ((size_t)1 << 26)
#define CROWDED UINT32_MAX /* entry of a small cell with too many candidates */
#define GATHERED 32u       /* most points around a small cell that a block is chosen from */
#define EXTRA EK_R(1.0)    /* half diagonals gathered beyond the candidates: a farther bound saves later searches */

ek_status ek_table_init(ek_table *table, ek_arena *arena, ek_index *index, size_t tiles, size_t blocks)
{
    if (!table || !arena || !index) {
        return EK_NULL_POINTER;
    }
    if (tiles == 0u || blocks == 0u || tiles > MAX_COUNT || blocks > MAX_COUNT) {
        return EK_OUT_OF_RANGE;
    }
    memset(table, 0, sizeof *table);
    table->tile_capacity = tiles + 1u;
    table->block_capacity = blocks + 1u;
    table->cell_capacity = index->cell_capacity;
    table->tile = (uint32_t *)ek_arena_alloc(arena, index->cell_capacity, sizeof(uint32_t));
    table->entry = (uint32_t *)ek_arena_alloc(arena, table->tile_capacity, EK_TILE * sizeof(uint32_t));
    table->block = (ek_block *)ek_arena_alloc(arena, table->block_capacity, sizeof(ek_block));
    if (arena->memory && ek_arena_check(arena) == EK_OK) {
        table->version = index->version - 1u;
        index->table = table;
    }
    return EK_OK;
}

void ek_table_attach(ek_table *table, const ek_index *index)
{
    if (table->version != index->version) {
        table->version = index->version;
        table->tiles = table->blocks = 1u;
        memset(table->tile, 0, (size_t)index->cells.columns * index->cells.rows * sizeof(uint32_t));
        memset(table->entry, 0, EK_TILE * sizeof(uint32_t));
    }
}

/* Points around the centre of a small cell. */
typedef struct {
    ek_real x, y, half; /* of the cell: centre and half width, rounding included (m) */
    ek_real margin;
    size_t count;
    uint32_t slot[GATHERED];
    ek_real dx[GATHERED], dy[GATHERED], squared[GATHERED]; /* from the centre */
} surroundings;

/* Gather the points within `radius` (m) of the centre; 0 if there are too many. */
static int gather(const ek_index *index, surroundings *near, ek_real radius)
{
    const ek_cell_box box = ek_cell_grid_box(&index->cells, near->x, near->y, radius + near->margin);
    near->count = 0u;
    for (int32_t row = box.bottom; row <= box.top; row++) {
        const uint32_t *const start = index->start + (size_t)row * index->cells.columns;
        for (uint32_t k = start[box.left]; k < start[box.right + 1]; k++) {
            const ek_real dx = index->xy[2u * k] - near->x, dy = index->xy[2u * k + 1u] - near->y;
            if (dx * dx + dy * dy > radius * radius) {
                continue;
            }
            if (near->count == GATHERED) {
                return 0;
            }
            near->slot[near->count] = k;
            near->dx[near->count] = dx;
            near->dy[near->count] = dy;
            near->squared[near->count++] = dx * dx + dy * dy;
        }
    }
    return 1;
}

/* 1 if some point is nearer than point k at every place of the cell. The difference of the squared distances is linear
 * in the place: it is checked at the corner where it is smallest. */
static int is_dominated(const surroundings *near, size_t k, ek_real tolerance)
{
    for (size_t j = 0; j < near->count; j++) {
        const ek_real apart = EK_FABS(near->dx[k] - near->dx[j]) + EK_FABS(near->dy[k] - near->dy[j]);
        if (near->squared[k] - near->squared[j] - EK_R(2.0) * near->half * apart > tolerance) {
            return 1;
        }
    }
    return 0;
}

/* Distance (m) of a point to the cell. */
static ek_real distance_to_cell(const surroundings *near, size_t k)
{
    const ek_real dx = EK_FABS(near->dx[k]) - near->half, dy = EK_FABS(near->dy[k]) - near->half;
    const ek_real u = dx > EK_R(0.0) ? dx : EK_R(0.0), v = dy > EK_R(0.0) ? dy : EK_R(0.0);
    return EK_SQRT(u * u + v * v);
}

/* Insert a point by its index in the cloud; 0 if the block is full. */
static int insert(const ek_index *index, ek_block *block, size_t count, uint32_t slot)
{
    if (count == EK_BLOCK) {
        return 0;
    }
    size_t k = count;
    for (; k > 0u && index->id[block->slot[k - 1u]] > index->id[slot]; k--) {
        block->slot[k] = block->slot[k - 1u];
    }
    block->slot[k] = slot;
    return 1;
}

/* Make the block of a small cell with the candidates for searches up to `limit` (m); 0 if it cannot hold them. */
static int make_block(const ek_index *index, surroundings *near, ek_real limit, ek_block *block)
{
    const ek_real diagonal = EK_R(1.42) * near->half; /* half of it */
    const ek_neighbour nearest =
        ek_index_nearest(index, near->x, near->y, limit + EK_R(2.0) * diagonal, index->cells.cell);
    size_t count = 0u;
    block->beyond = nearest.others - diagonal;
    if (nearest.slot != EK_NONE) {
        const ek_real radius = nearest.distance + (EK_R(2.0) + EXTRA) * diagonal + EK_R(4.0) * near->margin;
        if (!gather(index, near, radius)) {
            return 0;
        }
        const ek_real tolerance = EK_R(16.0) * near->margin * (radius + near->margin);
        block->beyond = radius - diagonal;
        for (size_t k = 0; k < near->count; k++) {
            if (is_dominated(near, k, tolerance)) {
                const ek_real distance = distance_to_cell(near, k);
                block->beyond = distance < block->beyond ? distance : block->beyond;
            } else if (!insert(index, block, count++, near->slot[k])) {
                return 0;
            }
        }
    }
    block->beyond -= near->margin;
    for (size_t k = 0; k < EK_BLOCK; k++) {
        block->slot[k] = k < count ? block->slot[k] : EK_NONE;
        block->x[k] = k < count ? index->xy[2u * block->slot[k]] : EK_FAR;
        block->y[k] = k < count ? index->xy[2u * block->slot[k] + 1u] : EK_FAR;
    }
    return 1;
}

/* Count a search of a small cell that has no block; make the block when it has had enough of them. */
static void count_search(ek_table *table, const ek_index *index, uint32_t column, uint32_t row, ek_real limit)
{
    const size_t cell = (size_t)(row / EK_TABLE_SPLIT) * index->cells.columns + column / EK_TABLE_SPLIT;
    if (table->tile[cell] == 0u) {
        if (table->tiles == table->tile_capacity) {
            return;
        }
        table->tile[cell] = (uint32_t)table->tiles;
        memset(table->entry + EK_TILE * table->tiles++, 0, EK_TILE * sizeof(uint32_t));
    }
    uint32_t *const entry = table->entry + EK_TILE * table->tile[cell] +
                            EK_TABLE_SPLIT * (row % EK_TABLE_SPLIT) + column % EK_TABLE_SPLIT;
    if (*entry == CROWDED) {
        return;
    }
    (*entry)++;
    if (*entry < EK_TABLE_PATIENCE) {
        return;
    }
    if (table->blocks == table->block_capacity) {
        (*entry)--;
        return;
    }
    surroundings near;
    const ek_real small = index->cells.cell / (ek_real)EK_TABLE_SPLIT;
    near.x = index->cells.left + ((ek_real)column + EK_R(0.5)) * small;
    near.y = index->cells.bottom + ((ek_real)row + EK_R(0.5)) * small;
    near.margin = index->cells.margin;
    near.half = EK_R(0.5) * small + near.margin;
    const int made = make_block(index, &near, limit, table->block + table->blocks);
    *entry = made ? EK_TABLE_PATIENCE + (uint32_t)table->blocks : CROWDED;
    table->blocks += made ? 1u : 0u;
}

/* Column and row of the small cell that contains (x, y); 0 outside the cells of the index. */
static inline int find_small_cell(const ek_index *index, ek_real x, ek_real y, uint32_t *column, uint32_t *row)
{
    const ek_cell_grid *const cells = &index->cells;
    const ek_real split = (ek_real)EK_TABLE_SPLIT;
    const ek_real u = (x - cells->left) * cells->per_cell * split, v = (y - cells->bottom) * cells->per_cell * split;
    const int inside = (u >= EK_R(0.0)) & (v >= EK_R(0.0)) & (u < split * (ek_real)cells->columns) &
                       (v < split * (ek_real)cells->rows);
    *column = inside ? (uint32_t)(int32_t)u : 0u;
    *row = inside ? (uint32_t)(int32_t)v : 0u;
    return inside;
}

void ek_table_locate(const ek_table *table, const ek_index *index, const ek_real *x, const ek_real *y,
                     const uint32_t *which, size_t count, uint32_t *at)
{
    for (size_t k = 0; k < count; k++) {
        uint32_t column, row;
        const int inside = find_small_cell(index, x[which[k]], y[which[k]], &column, &row);
        const uint32_t tile = table->tile[row / EK_TABLE_SPLIT * index->cells.columns + column / EK_TABLE_SPLIT];
        at[k] = inside ? EK_TILE * tile + EK_TABLE_SPLIT * (row % EK_TABLE_SPLIT) + column % EK_TABLE_SPLIT : 0u;
        EK_PREFETCH(table->entry + at[k]);
    }
    for (size_t k = 0; k < count; k++) {
        const uint32_t entry = table->entry[at[k]];
        const int made = (entry > EK_TABLE_PATIENCE) & (entry != CROWDED);
        at[k] = made ? entry - EK_TABLE_PATIENCE : 0u;
        EK_PREFETCH(table->block + at[k]);
        EK_PREFETCH(table->block[at[k]].slot);
    }
}

ek_neighbour ek_table_nearest(ek_table *table, const ek_index *index, uint32_t at, ek_real x, ek_real y, ek_real limit,
                              ek_real radius)
{
    if (at == 0u) {
        uint32_t column, row;
        if (index->count && find_small_cell(index, x, y, &column, &row)) {
            count_search(table, index, column, row, limit);
        }
        return ek_index_nearest(index, x, y, limit, radius);
    }
    const ek_block *const block = table->block + at;
    ek_real best = EK_FAR * EK_FAR, second = EK_FAR * EK_FAR;
    uint32_t slot = EK_NONE;
    for (size_t k = 0; k < EK_BLOCK; k++) {
        const ek_real dx = block->x[k] - x, dy = block->y[k] - y, squared = dx * dx + dy * dy;
        const ek_real worse = squared > best ? squared : best;
        second = worse < second ? worse : second;
        slot = squared < best ? block->slot[k] : slot;
        best = squared < best ? squared : best;
    }
    best = EK_SQRT(best);
    second = EK_SQRT(second);
    if (slot == EK_NONE && block->beyond < limit) { /* made for searches up to a smaller limit */
        return ek_index_nearest(index, x, y, limit, radius);
    }
    const ek_real others = best < limit ? second : best;
    const ek_neighbour answer = {best < limit ? slot : EK_NONE, best, others < block->beyond ? others : block->beyond};
    return answer;
}

#include "ek/table.h"

#include <string.h>

#define MAX_COUNT ((size_t)1 << 26)
#define CROWDED UINT32_MAX /* entry of a small cell with too many candidates */
#define GATHERED 64u       /* most points around a small cell that a block is chosen from */

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
        memset(table->block, 0, sizeof *table->block);
    }
}

/* Points around the centre of a small cell. */
typedef struct {
    ek_real x, y, half; /* of the cell: centre and half width, rounding included (m) */
    ek_real margin, radius; /* gathered within `radius` */
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

/* Insert a point by its index in the cloud into a block that has `count` points. */
static void insert(const ek_index *index, ek_block *block, size_t count, uint32_t slot)
{
    size_t k = count;
    for (; k > 0u && index->id[block->slot[k - 1u]] > index->id[slot]; k--) {
        block->slot[k] = block->slot[k - 1u];
    }
    block->slot[k] = slot;
}

/* Gather the points that can be nearest to a place in the cell, and if possible more than a block holds. */
static int gather_enough(const ek_index *index, surroundings *near, ek_real distance)
{
    ek_real radius = distance + EK_R(4.0) * near->half + EK_R(4.0) * near->margin;
    near->radius = radius;
    if (!gather(index, near, radius)) {
        return 0;
    }
    while (near->count <= EK_BLOCK && radius < EK_R(2.0) * index->cells.cell) {
        radius *= EK_R(1.5);
        if (!gather(index, near, radius)) {
            return gather(index, near, near->radius);
        }
        near->radius = radius;
    }
    return 1;
}

/* Fill a block that has `count` points with the nearest to the centre of the points `spare`; returns the number of its
 * points. A farther bound on the others saves searches. */
static size_t fill_block(const ek_index *index, const surroundings *near, size_t *spare, size_t spares, size_t count,
                         ek_block *block)
{
    block->others = near->radius;
    while (spares > 0u) {
        size_t least = 0u;
        for (size_t k = 1; k < spares; k++) {
            least = near->squared[spare[k]] < near->squared[spare[least]] ? k : least;
        }
        if (count == EK_BLOCK) {
            const ek_real next = EK_SQRT(near->squared[spare[least]]);
            block->others = next < near->radius ? next : near->radius;
            break;
        }
        insert(index, block, count++, near->slot[spare[least]]);
        spare[least] = spare[--spares];
    }
    return count;
}

/* Make the block of a small cell for searches up to `limit` (m); 0 if too many points are around it. */
static int make_block(const ek_index *index, surroundings *near, ek_real limit, ek_block *block)
{
    const ek_neighbour nearest =
        ek_index_nearest(index, near->x, near->y, limit + EK_R(2.0) * near->half, index->cells.cell);
    size_t count = 0u, spare[GATHERED], spares = 0u, candidates = 0u;
    block->centre_x = near->x;
    block->centre_y = near->y;
    block->others = nearest.others;
    block->complete = 0u;
    if (nearest.slot != EK_NONE) {
        if (!gather_enough(index, near, nearest.distance)) {
            return 0;
        }
        int dominated[GATHERED];
        const ek_real tolerance = EK_R(16.0) * near->margin * (near->radius + near->margin);
        for (size_t k = 0; k < near->count; k++) {
            dominated[k] = is_dominated(near, k, tolerance);
            candidates += dominated[k] ? 0u : 1u;
        }
        block->complete = candidates <= EK_BLOCK;
        for (size_t k = 0; k < near->count; k++) {
            if (block->complete && !dominated[k]) {
                insert(index, block, count++, near->slot[k]);
            } else {
                spare[spares++] = k;
            }
        }
        count = fill_block(index, near, spare, spares, count, block);
    }
    block->others -= near->margin;
    for (size_t k = 0; k < EK_BLOCK; k++) {
        block->slot[k] = k < count ? block->slot[k] : 0u;
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

/* Column and row of the small cell that contains (x, y); 0 outside the cells of the index and on their lower left. */
static inline int find_small_cell(const ek_cell_grid *cells, ek_real x, ek_real y, uint32_t *column, uint32_t *row)
{
    const ek_real per_small = cells->per_cell * (ek_real)EK_TABLE_SPLIT, half = EK_R(0.5) * (ek_real)EK_TABLE_SPLIT;
    const ek_real across = half * (ek_real)cells->columns, up = half * (ek_real)cells->rows;
    const ek_real u = (x - cells->left) * per_small, v = (y - cells->bottom) * per_small;
    const int inside = (EK_FABS(u - across) < across) & (EK_FABS(v - up) < up);
    *column = (uint32_t)(int32_t)(inside ? u : EK_R(0.0));
    *row = (uint32_t)(int32_t)(inside ? v : EK_R(0.0));
    return inside;
}

void ek_table_locate(const ek_table *table, const ek_index *index, const ek_real *EK_RESTRICT x,
                     const ek_real *EK_RESTRICT y, const uint32_t *EK_RESTRICT which, size_t count,
                     uint32_t *EK_RESTRICT at)
{
    const ek_cell_grid cells = index->cells;
    const uint32_t *const EK_RESTRICT tiles = table->tile, *const EK_RESTRICT entries = table->entry;
    for (size_t k = 0; k < count; k++) {
        uint32_t column, row;
        const int inside = find_small_cell(&cells, x[which[k]], y[which[k]], &column, &row);
        const uint32_t tile = tiles[row / EK_TABLE_SPLIT * cells.columns + column / EK_TABLE_SPLIT];
        const uint32_t entry = EK_TILE * tile + EK_TABLE_SPLIT * (row % EK_TABLE_SPLIT) + column % EK_TABLE_SPLIT;
        at[k] = entry & (0u - (uint32_t)inside);
        EK_PREFETCH(entries + at[k]);
    }
    for (size_t k = 0; k < count; k++) {
        const uint32_t entry = entries[at[k]];
        const int made = (entry > EK_TABLE_PATIENCE) & (entry != CROWDED);
        at[k] = (entry - EK_TABLE_PATIENCE) & (0u - (uint32_t)made);
    }
}

/* 1 if the point of a block that is nearest to (x, y) is nearer than all points outside the block. */
static int is_proven(const ek_block *block, const ek_index *index, ek_real x, ek_real y, ek_real limit)
{
    const ek_real wx = x - block->centre_x, wy = y - block->centre_y;
    ek_real best = limit * limit;
    for (size_t k = 0; k < EK_BLOCK; k++) {
        const ek_real dx = block->x[k] - x, dy = block->y[k] - y, squared = dx * dx + dy * dy;
        best = squared < best ? squared : best;
    }
    return EK_SQRT(best) + EK_SQRT(wx * wx + wy * wy) + EK_R(2.0) * index->cells.margin < block->others;
}

const ek_block *ek_table_block(ek_table *table, const ek_index *index, uint32_t at, ek_real x, ek_real y, ek_real limit)
{
    const ek_block *const block = table->block + at;
    uint32_t column, row;
    if (at == 0u) {
        if (index->count && find_small_cell(&index->cells, x, y, &column, &row)) {
            count_search(table, index, column, row, limit);
        }
        return NULL;
    }
    return block->complete || is_proven(block, index, x, y, limit) ? block : NULL;
}

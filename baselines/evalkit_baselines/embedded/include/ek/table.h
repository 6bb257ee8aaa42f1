/* table.h - a nearest-point table: neighbours that searches of a lasting target have found, kept for later searches.
 *
 * Each cell of an index is divided into a tile of small cells. A small cell that was searched EK_TABLE_PATIENCE times
 * gets a block: the few points that can be nearest to a place in it. All others are proven to be farther than one of
 * them at every place of the cell. A later search compares the points of the block, and finds what ek_index_nearest
 * finds. Everything else is searched in the index: places outside its cells, cells with more candidates than a block
 * holds, and cells for which there is no memory left.
 */
#ifndef EK_TABLE_H
#define EK_TABLE_H

#include "ek/index.h"

#ifdef __cplusplus
extern "C" {
#endif

#define EK_TABLE_PATIENCE 3u /* searches of a small cell before its block is made; a block costs as much as some */
#define EK_TABLE_SPLIT 4u    /* small cells along the side of a cell */
#define EK_TILE (EK_TABLE_SPLIT * EK_TABLE_SPLIT)
#define EK_BLOCK 6u          /* points */

/* The points that can be nearest to a place in a small cell, and the next nearest to its centre, by ascending index in
 * the cloud. */
typedef struct {
    ek_real x[EK_BLOCK], y[EK_BLOCK]; /* m; EK_FAR where there are fewer */
    ek_real centre_x, centre_y;       /* of the small cell (m) */
    ek_real others;                   /* lower bound on the distance from the centre to all other points (m) */
    uint32_t slot[EK_BLOCK];          /* 0 where there are fewer */
    uint32_t complete;                /* 1: one of them is nearest to each place in the cell; 0: perhaps */
} ek_block;

struct ek_table {
    size_t tile_capacity, block_capacity, cell_capacity;
    size_t tiles, blocks;  /* in use; tile 0 and block 0 are none */
    uint32_t version;      /* of the index */
    uint32_t *tile;        /* cell -> its tile, 0: none */
    uint32_t *entry;       /* tile -> EK_TILE numbers: of searches so far, or EK_TABLE_PATIENCE + block */
    ek_block *block;
};

#define ek_table_init EK_NAME(table_init)
#define ek_table_attach EK_NAME(table_attach)
#define ek_table_locate EK_NAME(table_locate)
#define ek_table_block EK_NAME(table_block)

/* Initialise an empty table for up to `tiles` cells of an index and `blocks` small cells in an arena (or measure it:
 * arena->used is then the memory needed). The index refers to the table from now on; its next update clears it.
 * EK_OUT_OF_RANGE: tiles or blocks is 0 or above 2^26. Rule of thumb: as many tiles as the index has cells near points,
 * 6 blocks per tile. A full table makes searches slower, not wrong. An index with a table must not be searched by two
 * threads at once. */
ek_status ek_table_init(ek_table *table, ek_arena *arena, ek_index *index, size_t tiles, size_t blocks);

/* Clear the table if the index has changed since the last call. Call it before a series of searches. */
void ek_table_attach(ek_table *table, const ek_index *index);

/* Find the blocks of the small cells that contain the points which[0..count-1] of x, y (m): at[k], 0 if there is none.
 * Reads of memory overlap here, which hides most of their latency. */
void ek_table_locate(const ek_table *table, const ek_index *index, const ek_real *EK_RESTRICT x,
                     const ek_real *EK_RESTRICT y, const uint32_t *EK_RESTRICT which, size_t count,
                     uint32_t *EK_RESTRICT at);

/* The block `at` (from ek_table_locate for (x, y)) if it holds the point nearest to (x, y) or no point is nearer than
 * `limit` (m); else NULL: search the index. Counts the searches of a small cell without a block. If the block is complete,
 * it is the answer, without this call. */
const ek_block *ek_table_block(ek_table *table, const ek_index *index, uint32_t at, ek_real x, ek_real y, ek_real limit);

#ifdef __cplusplus
}
#endif
#endif

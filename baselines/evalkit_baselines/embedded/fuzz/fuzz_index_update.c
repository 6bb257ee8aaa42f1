/* Arbitrary updates: an updated index equals, to the bit, one built from the same cloud, or is unchanged. */
#include "ek/index_update.h"
#include "input.h"

#define MAX_COUNT 32u

typedef struct {
    ek_index index;
    ek_index_updater merge;
    ek_arena arena;
} room;

static void init(room *made, size_t cells)
{
    ek_arena measured = ek_arena_make(NULL, 0u);
    HOLDS(ek_index_init(&made->index, &measured, MAX_COUNT, cells) == EK_OK);
    HOLDS(ek_index_updater_init(&made->merge, &measured, MAX_COUNT) == EK_OK);
    made->arena = memory_for(&measured);
    HOLDS(ek_index_init(&made->index, &made->arena, MAX_COUNT, cells) == EK_OK);
    HOLDS(ek_index_updater_init(&made->merge, &made->arena, MAX_COUNT) == EK_OK &&
          ek_arena_check(&made->arena) == EK_OK);
}

static void are_equal(const ek_index *a, const ek_index *b)
{
    const size_t entries = (size_t)a->cells.columns * a->cells.rows + 1u;
    HOLDS(a->count == b->count);
    if (a->count) {
        HOLDS(memcmp(&a->cells.left, &b->cells.left, sizeof a->cells.left) == 0);
        HOLDS(memcmp(&a->cells.bottom, &b->cells.bottom, sizeof a->cells.bottom) == 0);
        HOLDS(memcmp(&a->cells.cell, &b->cells.cell, sizeof a->cells.cell) == 0);
        HOLDS(a->cells.columns == b->cells.columns && a->cells.rows == b->cells.rows && a->occupied == b->occupied);
        HOLDS(memcmp(a->xy, b->xy, 2u * a->count * sizeof *a->xy) == 0);
        HOLDS(memcmp(a->id, b->id, a->count * sizeof *a->id) == 0);
        HOLDS(memcmp(a->start, b->start, entries * sizeof *a->start) == 0);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    static room updated, built;
    ek_input input = {bytes, size};
    ek_real cloud[2u * MAX_COUNT];
    size_t held = 0u;
    const size_t cells = 1u + take_byte(&input);
    init(&updated, cells);
    init(&built, cells);
    for (int changes = 0; changes < 24 && input.left; changes++) {
        const size_t removed = take_byte(&input) % (MAX_COUNT + 2u), count = take_byte(&input) % (MAX_COUNT + 2u);
        ek_real *const added = take_reals(&input, 2u * count);
        const ek_status status = ek_index_update(&updated.merge, &updated.index, removed, added, count);
        HOLDS(status != EK_OK || removed <= held);
        if (status == EK_OK) {
            held -= removed;
            memmove(cloud, cloud + 2u * removed, 2u * held * sizeof *cloud);
            memcpy(cloud + 2u * held, added, 2u * count * sizeof *cloud);
            held += count;
            HOLDS(ek_index_build(&built.index, cloud, held) == EK_OK);
        }
        are_equal(&updated.index, &built.index);
        free(added);
    }
    free(updated.arena.memory);
    free(built.arena.memory);
    return 0;
}

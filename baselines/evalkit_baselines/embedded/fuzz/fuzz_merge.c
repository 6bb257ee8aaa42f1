/* An index that is brought up to date is to the bit the one that is built from the same cloud, or is as it was. */
#include "ek/merge.h"
#include "taken.h"

#define MOST 32u

typedef struct {
    ek_index index;
    ek_merge merge;
    ek_arena arena;
} room;

static void lay_out(room *made, size_t cells)
{
    ek_arena measured = ek_arena_over(NULL, 0u);
    HOLDS(ek_index_lay_out(&made->index, &measured, MOST, cells) == EK_OK);
    HOLDS(ek_merge_lay_out(&made->merge, &measured, MOST) == EK_OK);
    made->arena = memory_for(&measured);
    HOLDS(ek_index_lay_out(&made->index, &made->arena, MOST, cells) == EK_OK);
    HOLDS(ek_merge_lay_out(&made->merge, &made->arena, MOST) == EK_OK && ek_arena_check(&made->arena) == EK_OK);
}

static void are_equal(const ek_index *a, const ek_index *b)
{
    const size_t entries = (size_t)a->frame.columns * a->frame.rows + 1u;
    HOLDS(a->count == b->count);
    if (a->count) {
        HOLDS(memcmp(&a->frame.left, &b->frame.left, sizeof a->frame.left) == 0);
        HOLDS(memcmp(&a->frame.bottom, &b->frame.bottom, sizeof a->frame.bottom) == 0);
        HOLDS(memcmp(&a->frame.cell, &b->frame.cell, sizeof a->frame.cell) == 0);
        HOLDS(a->frame.columns == b->frame.columns && a->frame.rows == b->frame.rows && a->occupied == b->occupied);
        HOLDS(memcmp(a->xy, b->xy, 2u * a->count * sizeof *a->xy) == 0);
        HOLDS(memcmp(a->id, b->id, a->count * sizeof *a->id) == 0);
        HOLDS(memcmp(a->start, b->start, entries * sizeof *a->start) == 0);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    static room updated, built;
    ek_input input = {bytes, size};
    ek_real cloud[2u * MOST];
    size_t held = 0u;
    const size_t cells = 1u + take_byte(&input);
    lay_out(&updated, cells);
    lay_out(&built, cells);
    for (int changes = 0; changes < 24 && input.left; changes++) {
        const size_t removed = take_byte(&input) % (MOST + 2u), count = take_byte(&input) % (MOST + 2u);
        ek_real *const added = take_reals(&input, 2u * count);
        const ek_status status = ek_merge_update(&updated.merge, &updated.index, removed, added, count);
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

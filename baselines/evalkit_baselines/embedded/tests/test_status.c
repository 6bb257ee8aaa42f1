#include "check.h"

int main(void)
{
    for (int k = 0; k < (int)EK_STATUS_COUNT; k++) {
        CHECK(ek_status_text((ek_status)k) != NULL && strlen(ek_status_text((ek_status)k)) > 5u);
    }
    CHECK(strcmp(ek_status_text((ek_status)99), "unknown status") == 0);

    /* a measuring arena counts the same bytes as an allocating one; a full arena returns NULL */
    const size_t bytes = EK_ARENA_GAP ? 128u : 64u; /* of a block of 60, on every processor */
    ek_arena measured = ek_arena_make(NULL, 0u), given = memory_of(bytes);
    CHECK(ek_arena_alloc(&measured, 15u, 4u) == NULL && ek_arena_alloc(&given, 15u, 4u) == given.memory);
    CHECK(measured.used == bytes && given.used == bytes && ek_arena_check(&given) == EK_OK);
    CHECK(ek_arena_alloc(&given, 5u, 8u) == NULL && ek_arena_check(&given) == EK_TOO_LITTLE_MEMORY);
    CHECK(ek_arena_alloc(&given, SIZE_MAX / 2u, 8u) == NULL && ek_arena_check(&given) == EK_TOO_LITTLE_MEMORY);
    for (size_t count = 0; count < 3u; count++) { /* no later allocation hides that a size did not fit */
        CHECK(given.used > EK_ARENA_MAX && ek_arena_alloc(&given, count, 8u) == NULL);
    }
    CHECK(ek_arena_alloc(&measured, 2u, SIZE_MAX / 4u) == NULL && measured.used > EK_ARENA_MAX);
    free(given.memory);
    return verdict();
}

#include "ek/arena.h"

ek_arena ek_arena_over(void *memory, size_t bytes)
{
    ek_arena arena;
    arena.memory = (unsigned char *)memory;
    arena.bytes = memory ? bytes : 0u;
    arena.used = 0u;
    return arena;
}

void *ek_arena_take(ek_arena *arena, size_t count, size_t size)
{
    size_t start = arena->used;
    if (size != 0u && count > (SIZE_MAX / 2u - start) / size) {
        arena->used = SIZE_MAX / 2u;
        return NULL;
    }
    arena->used = (start + count * size + (EK_ALIGNMENT - 1u)) / EK_ALIGNMENT * EK_ALIGNMENT;
    if (!arena->memory || arena->used > arena->bytes) {
        return NULL;
    }
    return arena->memory + start;
}

ek_status ek_arena_check(const ek_arena *arena)
{
    if (!arena->memory || arena->used > arena->bytes || (uintptr_t)arena->memory % EK_ALIGNMENT != 0u) {
        return EK_TOO_LITTLE_MEMORY;
    }
    return EK_OK;
}

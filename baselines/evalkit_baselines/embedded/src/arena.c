#include "ek/arena.h"

#ifdef EK_GUARDED
#include <sanitizer/asan_interface.h>
#define GUARD(start, bytes) __asan_poison_memory_region((start), (bytes))
#define OPEN(start, bytes) __asan_unpoison_memory_region((start), (bytes))
#else
#define GUARD(start, bytes) ((void)(start), (void)(bytes))
#define OPEN(start, bytes) ((void)(start), (void)(bytes))
#endif

ek_arena ek_arena_make(void *memory, size_t bytes)
{
    ek_arena arena;
    arena.memory = (unsigned char *)memory;
    arena.bytes = memory ? bytes : 0u;
    arena.used = 0u;
    return arena;
}

void *ek_arena_alloc(ek_arena *arena, size_t count, size_t size)
{
    const size_t start = arena->used;
    if (start > EK_ARENA_MAX || (size != 0u && count > (EK_ARENA_MAX - start) / size)) {
        arena->used = SIZE_MAX;
        return NULL;
    }
    const size_t end = start + count * size;
    arena->used = (end + EK_ARENA_GAP + (EK_ARENA_LINE - 1u)) / EK_ARENA_LINE * EK_ARENA_LINE;
    if (!arena->memory || arena->used > arena->bytes) {
        return NULL;
    }
    OPEN(arena->memory + start, end - start); /* where another arena had a gap */
    GUARD(arena->memory + end, arena->used - end);
    return arena->memory + start;
}

ek_status ek_arena_check(const ek_arena *arena)
{
    if (!arena->memory || arena->used > arena->bytes || (uintptr_t)arena->memory % EK_ALIGNMENT != 0u) {
        return EK_TOO_LITTLE_MEMORY;
    }
    return EK_OK;
}

/* arena.h - allocate aligned blocks from memory that the caller provides; blocks are never freed.
 *
 * An arena without memory only counts bytes, so the same init function also measures how much a module needs.
 */
#ifndef EK_ARENA_H
#define EK_ARENA_H

#include "ek/status.h"
#include "ek/wide.h"

#ifdef __cplusplus
extern "C" {
#endif

#define EK_ALIGNMENT 16u
#define EK_ARENA_MAX (SIZE_MAX / 2u) /* bytes */

/* Bytes to whose multiples blocks begin: vectors that lie on two cache lines take twice as long. */
#if EK_GROUPED
#define EK_ARENA_LINE 64u
#else
#define EK_ARENA_LINE EK_ALIGNMENT
#endif

#ifdef EK_GUARDED /* under AddressSanitizer: the gap behind each block is poisoned */
#define EK_ARENA_GAP EK_ALIGNMENT
#else
#define EK_ARENA_GAP 0u
#endif

typedef struct {
    unsigned char *memory; /* NULL: only count bytes */
    size_t bytes;          /* size of memory */
    size_t used;           /* bytes allocated; more than `bytes` after a failed allocation, more than EK_ARENA_MAX after
                              one that no memory of this processor can hold */
} ek_arena;

#define ek_arena_make EK_NAME(arena_make)
#define ek_arena_alloc EK_NAME(arena_alloc)
#define ek_arena_check EK_NAME(arena_check)

/* Make an arena from memory aligned to EK_ALIGNMENT; (NULL, 0) makes one that only counts bytes. */
ek_arena ek_arena_make(void *memory, size_t bytes);

/* Allocate count items of size bytes each, aligned. NULL if the arena only counts, is full, or the product overflows.
 */
void *ek_arena_alloc(ek_arena *arena, size_t count, size_t size);

/* EK_OK if every allocation succeeded; EK_TOO_LITTLE_MEMORY if not, or if the memory is not aligned. */
ek_status ek_arena_check(const ek_arena *arena);

#ifdef __cplusplus
}
#endif
#endif

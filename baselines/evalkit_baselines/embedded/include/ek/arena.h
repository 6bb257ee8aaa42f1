/* arena.h - memory handed in by the caller, given out once in aligned pieces and never returned.
 *
 * The same code that lays a module out in an arena also measures it: an arena over no memory only counts.
 */
#ifndef EK_ARENA_H
#define EK_ARENA_H

#include "ek/status.h"

#ifdef __cplusplus
extern "C" {
#endif

#define EK_ALIGNMENT 16u

typedef struct {
    unsigned char *memory; /* NULL: only measures */
    size_t bytes;          /* of memory */
    size_t used;           /* so far; may exceed bytes, then taking has failed */
} ek_arena;

#define ek_arena_over EK_NAME(arena_over)
#define ek_arena_take EK_NAME(arena_take)
#define ek_arena_check EK_NAME(arena_check)

/* An arena over memory aligned to EK_ALIGNMENT; (NULL, 0) gives one that only measures. */
ek_arena ek_arena_over(void *memory, size_t bytes);

/* The next count items of size bytes each, aligned; NULL when measuring, when full or when the product overflows. */
void *ek_arena_take(ek_arena *arena, size_t count, size_t size);

/* EK_OK when everything taken was there; EK_TOO_LITTLE_MEMORY when not, or when the memory is badly aligned. */
ek_status ek_arena_check(const ek_arena *arena);

#ifdef __cplusplus
}
#endif
#endif

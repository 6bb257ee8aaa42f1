/* Reading a line of evalkit's protocol without a JSON library: the keys are in a known order, without spaces. */
#ifndef LINES_H
#define LINES_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef struct {
    double *xy;
    size_t numbers, room;
} cloud;

/* Neither infinite nor nan, which JSON cannot say. By the bits: with -ffast-math isfinite() is true for every value. */
static inline int is_finite(double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return (bits >> 52 & 0x7ff) != 0x7ff;
}

static inline long long now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

/* Return where the value of a key begins, or NULL. */
static inline const char *value_of(const char *line, const char *key)
{
    const char *found = strstr(line, key);
    return found ? found + strlen(key) : NULL;
}

/* Read the numbers of a list such as [1,2.5,-3e-4]; return 0 if there is no memory for them. */
static inline int read_list(const char *line, const char *key, cloud *into)
{
    const char *at = value_of(line, key);
    into->numbers = 0;
    while (at && (*at == '[' || *at == ',')) {
        char *end;
        double number = strtod(at + 1, &end);
        if (end == at + 1)
            break; /* an empty list */
        if (into->numbers == into->room) {
            size_t room = into->room ? 2 * into->room : 1024;
            double *more = realloc(into->xy, room * sizeof *more);
            if (!more)
                return 0;
            into->xy = more, into->room = room;
        }
        into->xy[into->numbers++] = number;
        at = end;
    }
    return 1;
}

#endif

/* check.h - test support: a check that prints its location, repeatable random numbers, memory. */
#ifndef EK_TEST_CHECK_H
#define EK_TEST_CHECK_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ek/arena.h"

static int failures;

#define CHECK(condition)                                                                                              \
    do {                                                                                                              \
        if (!(condition)) {                                                                                           \
            fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition);                                           \
            failures++;                                                                                               \
        }                                                                                                             \
    } while (0)

#define CHECK_NEAR(found, expected, tolerance)                                                                        \
    do {                                                                                                              \
        const double found_ = (double)(found), expected_ = (double)(expected);                                        \
        if (!(fabs(found_ - expected_) <= (double)(tolerance))) {                                                     \
            fprintf(stderr, "%s:%d: %s: found %.17g, expected %.17g\n", __FILE__, __LINE__, #found, found_,           \
                    expected_);                                                                                       \
            failures++;                                                                                               \
        }                                                                                                             \
    } while (0)

/* Tolerance of a build, for numbers around 1. */
#ifdef EK_FLOAT
#define TOLERANCE 2e-5
#else
#define TOLERANCE 1e-10
#endif

/* Where a sensor is: x y (m). */
#define AT_BASE ((const ek_real[]){EK_R(0.0), EK_R(0.0)})

/* Random number in [low, high); the same sequence on every machine (Marsaglia 2003, xorshift64). */
static inline ek_real uniform(uint64_t *state, double low, double high)
{
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    return EK_R(low + (high - low) * ((double)(*state >> 11) / 9007199254740992.0));
}

/* Allocate the arena of a test, once; it does not begin as zeros, on which the code must not rely. */
static inline ek_arena memory_of(size_t bytes)
{
    void *const memory = malloc(bytes);
    if (!memory) {
        fprintf(stderr, "no memory\n");
        exit(EXIT_FAILURE);
    }
    memset(memory, 0xA5, bytes);
    return ek_arena_make(memory, bytes);
}

static inline int verdict(void)
{
    return failures ? EXIT_FAILURE : EXIT_SUCCESS;
}

#endif

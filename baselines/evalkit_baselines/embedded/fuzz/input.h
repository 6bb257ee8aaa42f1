/* input.h - numbers, points and scans from a fuzzer's bytes, and assertions. */
#ifndef EK_FUZZ_INPUT_H
#define EK_FUZZ_INPUT_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ek/arena.h"
#include "ek/se2.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size);

/* Abort if a condition does not hold, so that the fuzzer saves the input. */
#define HOLDS(condition)                                                                                              \
    do {                                                                                                              \
        if (!(condition)) {                                                                                           \
            fprintf(stderr, "%s:%d: does not hold: %s\n", __FILE__, __LINE__, #condition);                            \
            abort();                                                                                                  \
        }                                                                                                             \
    } while (0)

/* Remaining input; zeros after its end. */
typedef struct {
    const uint8_t *bytes;
    size_t left;
} ek_input;

static inline void take(ek_input *input, void *into, size_t size)
{
    const size_t there = size < input->left ? size : input->left;
    memset(into, 0, size);
    if (there) {
        memcpy(into, input->bytes, there);
        input->bytes += there;
        input->left -= there;
    }
}

static inline uint8_t take_byte(ek_input *input)
{
    uint8_t byte;
    take(input, &byte, 1u);
    return byte;
}

static inline int64_t take_whole(ek_input *input)
{
    int64_t whole;
    take(input, &whole, sizeof whole);
    return whole;
}

/* A stamp, time or count: mostly small, sometimes arbitrary. */
static inline int64_t take_time(ek_input *input)
{
    const uint8_t kind = take_byte(input);
    return kind < 240u ? (int64_t)kind * 1000 : take_whole(input);
}

/* Mostly millimetres within 33 m; sometimes an edge case; sometimes arbitrary bits. */
static inline ek_real take_real(ek_input *input)
{
    static const double odd[] = {NAN,  INFINITY, -INFINITY, 0.0,  -0.0,   1e6,   -1e6,  1.0000001e6,
                                 1e18, 1e-30,    -1e-30,    1e30, -1e300, 1e300, 5e-324, 3.14159265358979};
    const uint8_t kind = take_byte(input);
    if (kind < 208u) {
        int16_t millimetres;
        take(input, &millimetres, sizeof millimetres);
        return (ek_real)millimetres / EK_R(1000.0);
    }
    if (kind < 248u) {
        return (ek_real)odd[kind % (sizeof odd / sizeof *odd)];
    }
    ek_real any;
    take(input, &any, sizeof any);
    return any;
}

static inline ek_pose take_pose(ek_input *input)
{
    ek_pose pose;
    pose.x = take_real(input);
    pose.y = take_real(input);
    pose.theta = take_real(input);
    return pose;
}

/* Allocate an array of exactly the given length, so that reading beyond it is detected. */
static inline ek_real *take_reals(ek_input *input, size_t count)
{
    ek_real *const reals = (ek_real *)malloc(count ? count * sizeof *reals : 1u);
    HOLDS(reals != NULL);
    for (size_t i = 0; i < count; i++) {
        reals[i] = take_real(input);
    }
    return reals;
}

/* Allocate exactly the measured memory. */
static inline ek_arena memory_for(const ek_arena *measured)
{
    const size_t bytes = measured->used ? measured->used : 1u;
    void *const memory = malloc(bytes); /* AddressSanitizer aligns it to EK_ALIGNMENT */
    HOLDS(memory != NULL);
    memset(memory, 0xA5, bytes); /* the code must not rely on zeros */
    return ek_arena_make(memory, bytes);
}

static inline int same_pose(ek_pose a, ek_pose b)
{
    return memcmp(&a, &b, sizeof a) == 0;
}

#endif

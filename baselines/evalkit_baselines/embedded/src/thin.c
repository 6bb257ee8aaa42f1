#include "ek/thin.h"

#include <string.h>

#define MAX_COUNT ((size_t)1 << 30)
#define MAX_DIGIT_BITS 11u
#define MAX_DIGITS ((uint32_t)1 << MAX_DIGIT_BITS)

ek_status ek_thinner_init(ek_thinner *thinner, ek_arena *arena, size_t capacity)
{
    if (!thinner || !arena) {
        return EK_NULL_POINTER;
    }
    if (capacity == 0u || capacity > MAX_COUNT) {
        return EK_OUT_OF_RANGE;
    }
    thinner->capacity = capacity;
    thinner->key = (uint64_t *)ek_arena_alloc(arena, capacity, sizeof(uint64_t));
    thinner->other_key = (uint64_t *)ek_arena_alloc(arena, capacity, sizeof(uint64_t));
    thinner->order = (uint32_t *)ek_arena_alloc(arena, capacity, sizeof(uint32_t));
    thinner->other_order = (uint32_t *)ek_arena_alloc(arena, capacity, sizeof(uint32_t));
    thinner->digits = (uint32_t *)ek_arena_alloc(arena, MAX_DIGITS + 1u, sizeof(uint32_t));
    return EK_OK;
}

/* Number the cells of the points row by row; returns the largest number. */
static uint64_t number_cells(ek_thinner *thinner, const ek_real *xy, size_t count, ek_real size)
{
    int64_t left = INT64_MAX, low = INT64_MAX, high = INT64_MIN;
    uint64_t largest = 0u;
    for (size_t i = 0; i < count; i++) {
        const int64_t x = ek_floor(xy[2u * i] / size), y = ek_floor(xy[2u * i + 1u] / size);
        thinner->key[i] = (uint64_t)x;
        thinner->other_key[i] = (uint64_t)y;
        left = x < left ? x : left;
        low = y < low ? y : low;
        high = y > high ? y : high;
    }
    const uint64_t height = (uint64_t)(high - low) + 1u;
    for (size_t i = 0; i < count; i++) {
        thinner->key[i] = (thinner->key[i] - (uint64_t)left) * height + (thinner->other_key[i] - (uint64_t)low);
        thinner->order[i] = (uint32_t)i;
        largest = thinner->key[i] > largest ? thinner->key[i] : largest;
    }
    return largest;
}

/* One stable pass of the radix sort, of keys up to `largest`; swaps the arrays. */
static void sort_by_digit(ek_thinner *thinner, size_t count, unsigned shift, unsigned bits, uint64_t largest)
{
    const uint32_t every = ((uint32_t)1 << bits) - 1u;
    uint32_t *const digits = thinner->digits, used = largest >> shift < every ? (uint32_t)(largest >> shift) + 1u : every + 1u;
    EK_COUNT(EK_CELLS, 2u * used);
    memset(digits, 0, (used + 1u) * sizeof *digits);
    for (size_t i = 0; i < count; i++) {
        digits[(thinner->key[i] >> shift & every) + 1u]++;
    }
    for (uint32_t digit = 1; digit < used; digit++) {
        digits[digit] += digits[digit - 1u];
    }
    for (size_t i = 0; i < count; i++) {
        const uint32_t to = digits[thinner->key[i] >> shift & every]++;
        thinner->other_key[to] = thinner->key[i];
        thinner->other_order[to] = thinner->order[i];
    }
    uint64_t *const key = thinner->key;
    uint32_t *const order = thinner->order;
    thinner->key = thinner->other_key;
    thinner->order = thinner->other_order;
    thinner->other_key = key;
    thinner->other_order = order;
}

static void sort_by_cell(ek_thinner *thinner, const ek_real *xy, size_t count, ek_real size, ek_work *work)
{
    const uint64_t largest = number_cells(thinner, xy, count, size);
    unsigned bits = 0u;
    while (bits < 64u && largest >> bits) {
        bits++;
    }
    const unsigned passes = (bits + MAX_DIGIT_BITS - 1u) / MAX_DIGIT_BITS, digit = passes ? (bits + passes - 1u) / passes : 0u;
    for (unsigned pass = 0; pass < passes; pass++) {
        sort_by_digit(thinner, count, pass * digit, digit, largest);
    }
    ek_work_spend(work, 8u * (uint64_t)count);
}

size_t ek_thin(ek_thinner *thinner, const ek_real *xy, size_t count, ek_real size, ek_real *means, ek_work *work)
{
    size_t cells = 0u;
    if (count == 0u) {
        return 0u;
    }
    sort_by_cell(thinner, xy, count, size, work);
    for (size_t from = 0, next; from < count; from = next, cells++) {
        ek_real x = EK_R(0.0), y = EK_R(0.0); /* local: a sum in memory waits for each store */
        for (next = from; next < count && thinner->key[next] == thinner->key[from]; next++) {
            const ek_real *const point = xy + 2u * (size_t)thinner->order[next];
            x += point[0];
            y += point[1];
        }
        means[2u * cells] = x / (ek_real)(next - from);
        means[2u * cells + 1u] = y / (ek_real)(next - from);
    }
    return cells;
}

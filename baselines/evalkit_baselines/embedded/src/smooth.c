#include "ek/smooth.h"

#define MAX_BEAMS 5u
#define MAX_SPAN (EK_R(1.2) * EK_PI / EK_R(180.0))
#define MIN_NOISE EK_R(0.02)                            /* m */
#define SECOND_DIFFERENCE EK_R(1.6521477960523424)      /* 0.6745 sqrt 6: median of |a + c - 2 b| for noise of 1 sigma */

/* The k-th smallest number; smaller ones end before it (Hoare's selection). */
static ek_real select_number(ek_real *numbers, size_t count, size_t k)
{
    size_t low = 0u, high = count - 1u;
    while (low < high) {
        const ek_real pivot = numbers[low + (high - low) / 2u];
        size_t i = low, j = high;
        for (;;) {
            while (numbers[i] < pivot) {
                i++;
            }
            while (numbers[j] > pivot) {
                j--;
            }
            if (i >= j) {
                break;
            }
            const ek_real swap = numbers[i];
            numbers[i++] = numbers[j];
            numbers[j--] = swap;
        }
        if (k <= j) { /* up to j no number is larger than any behind it */
            high = j;
        } else {
            low = j + 1u;
        }
    }
    return numbers[k];
}

static ek_real median(ek_real *numbers, size_t count)
{
    const ek_real upper = select_number(numbers, count, count / 2u);
    if (count % 2u) {
        return upper;
    }
    ek_real lower = numbers[0];
    for (size_t k = 1; k < count / 2u; k++) {
        lower = numbers[k] > lower ? numbers[k] : lower;
    }
    return EK_R(0.5) * (lower + upper);
}

/* Number of neighbouring beams in a median, odd. */
static size_t count_beams(const ek_real *angles, size_t beams, ek_real *scratch)
{
    if (beams < 2u) {
        return 1u;
    }
    for (size_t k = 0; k + 1u < beams; k++) {
        scratch[k] = EK_FABS(angles[k + 1u] - angles[k]);
        if (!isfinite(scratch[k])) {
            return 1u;
        }
    }
    const ek_real step = median(scratch, beams - 1u);
    if (step * EK_R(4.0) <= MAX_SPAN) {
        return MAX_BEAMS;
    }
    const size_t fitting = (size_t)(MAX_SPAN / step) + 1u;
    return fitting - 1u + fitting % 2u;
}

static ek_real estimate_noise(const ek_real *ranges, size_t beams, ek_real *scratch)
{
    size_t count = 0u;
    for (size_t k = 0; k + 2u < beams; k++) {
        const ek_real bend = EK_FABS(ranges[k] + ranges[k + 2u] - EK_R(2.0) * ranges[k + 1u]);
        scratch[count] = bend;
        count += isfinite(bend) ? 1u : 0u;
    }
    return count ? median(scratch, count) / SECOND_DIFFERENCE : EK_R(0.0);
}

/* Median of an odd number of ranges, at most MAX_BEAMS; `own` if one is invalid, or if there is none. */
static ek_real middle_of(const ek_real *ranges, size_t count, ek_real own)
{
    ek_real sorted[MAX_BEAMS] = {own};
    for (size_t k = 0; k < count; k++) {
        size_t at = k;
        if (!isfinite(ranges[k])) {
            return own;
        }
        for (; at > 0u && sorted[at - 1u] > ranges[k]; at--) {
            sorted[at] = sorted[at - 1u];
        }
        sorted[at] = ranges[k];
    }
    return sorted[count / 2u];
}

int ek_smooth_ranges(const ek_real *ranges, const ek_real *angles, size_t beams, ek_real *smoothed, ek_real *scratch)
{
    const size_t window = count_beams(angles, beams, scratch), half = window / 2u;
    if (window < 3u || beams < window || !(estimate_noise(ranges, beams, scratch) > MIN_NOISE)) {
        return 0;
    }
    for (size_t k = 0; k < beams; k++) {
        const int inside = k >= half && k + half < beams;
        smoothed[k] = inside ? middle_of(ranges + k - half, window, ranges[k]) : ranges[k];
    }
    return 1;
}

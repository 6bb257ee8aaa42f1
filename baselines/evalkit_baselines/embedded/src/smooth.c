#include "ek/smooth.h"

#define MAX_SPAN (EK_R(1.201) * EK_PI / EK_R(180.0)) /* 1.2 deg, so that beams 0.3 or 0.6 deg apart are fine whatever is rounded */
#define MIN_NOISE EK_R(0.02) /* m */
#define MEMORY 200u          /* scans of a mean at most */
#define SECOND_DIFFERENCE EK_R(1.6521808315072536) /* 0.6745 sqrt 6: median of |a + c - 2 b| for noise of 1 sigma */

/* Number of neighbouring beams in a median, odd: 5, 3 or 1, so that most of these span at most MAX_SPAN. */
static size_t count_beams(const ek_real *angles, size_t beams)
{
    size_t five = 0u, three = 0u;
    for (size_t k = 1; k < beams; k++) {
        const ek_real step = EK_FABS(angles[k] - angles[k - 1u]);
        five += (size_t)(EK_R(4.0) * step <= MAX_SPAN);
        three += (size_t)(EK_R(2.0) * step <= MAX_SPAN);
    }
    return 2u * five >= beams ? 5u : 2u * three >= beams ? 3u : 1u;
}

/* 1 if the second differences of most neighbours exceed what noise of MIN_NOISE has; steps and invalid ranges are few. */
static int is_noisy(const ek_real *ranges, size_t beams)
{
    size_t valid = 0u, large = 0u;
    for (size_t k = 2; k < beams; k++) {
        const ek_real bend = EK_FABS(ranges[k - 2u] + ranges[k] - EK_R(2.0) * ranges[k - 1u]);
        const int finite = bend < (ek_real)INFINITY;
        valid += (size_t)finite;
        large += (size_t)(finite & (bend > SECOND_DIFFERENCE * MIN_NOISE));
    }
    return 2u * large > valid;
}

static inline ek_real least(ek_real a, ek_real b)
{
    return a < b ? a : b;
}

static inline ek_real most(ek_real a, ek_real b)
{
    return a > b ? a : b;
}

static inline ek_real middle_of_3(ek_real a, ek_real b, ek_real c)
{
    return most(least(a, b), least(most(a, b), c));
}

/* Medians of 3 or 5 ranges around each but the first and last `half`; the own range where one of them is invalid. */
static void take_medians(const ek_real *EK_RESTRICT ranges, size_t beams, size_t half, ek_real *EK_RESTRICT smoothed)
{
    for (size_t k = half; half == 1u && k + half < beams; k++) {
        const ek_real a = ranges[k - 1u], b = ranges[k], c = ranges[k + 1u];
        smoothed[k] = (a - a) + (b - b) + (c - c) == EK_R(0.0) ? middle_of_3(a, b, c) : b;
    }
    for (size_t k = half; half == 2u && k + half < beams; k++) {
        const ek_real a = ranges[k - 2u], b = ranges[k - 1u], c = ranges[k], d = ranges[k + 1u], e = ranges[k + 2u];
        const ek_real low = most(least(a, b), least(d, e)), high = least(most(a, b), most(d, e));
        const ek_real invalid = (a - a) + (b - b) + (c - c) + (d - d) + (e - e); /* 0, or nan */
        smoothed[k] = invalid == EK_R(0.0) ? middle_of_3(low, high, c) : c;
    }
}

int ek_smooth_ranges(const ek_real *ranges, const ek_real *angles, size_t beams, ek_real *smoothed)
{
    const size_t half = count_beams(angles, beams) / 2u;
    if (half == 0u || beams < 2u * half + 1u || !is_noisy(ranges, beams)) {
        return 0;
    }
    for (size_t k = 0; k < half; k++) {
        smoothed[k] = ranges[k];
        smoothed[beams - 1u - k] = ranges[beams - 1u - k];
    }
    take_medians(ranges, beams, half, smoothed);
    return 1;
}

void ek_range_noise_observe(ek_range_noise *noise, int smoothed)
{
    noise->scans += noise->scans < MEMORY ? 1u : 0u;
    noise->share += ((ek_real)smoothed - noise->share) / (ek_real)noise->scans;
}

int ek_is_noisy(const ek_range_noise *noise)
{
    return noise->share > EK_R(0.5);
}

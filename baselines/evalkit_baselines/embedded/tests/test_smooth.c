#include "check.h"
#include "ek/smooth.h"

#define BEAMS 40u

static ek_real ranges[BEAMS], angles[BEAMS], smoothed[BEAMS];

/* Ranges that alternate by 10 cm, with one farther beam: second differences of 20 cm, 0.12 m of noise. */
static void fill(double step_deg)
{
    for (size_t k = 0; k < BEAMS; k++) {
        angles[k] = EK_R(step_deg) * (ek_real)k * EK_PI / EK_R(180.0);
        ranges[k] = k % 2u ? EK_R(1.1) : EK_R(1.0);
    }
    ranges[20] = EK_R(3.0);
}

static void the_median_of_five_fine_beams_is_taken(void)
{
    fill(0.25);
    ranges[30] = (ek_real)INFINITY;
    CHECK(ek_smooth_ranges(ranges, angles, BEAMS, smoothed));
    CHECK_NEAR(smoothed[10], 1.0, 1e-6); /* 1.0 1.1 1.0 1.1 1.0 */
    CHECK_NEAR(smoothed[11], 1.1, 1e-6);
    CHECK_NEAR(smoothed[20], 1.1, 1e-6); /* 1.0 1.1 3.0 1.1 1.0: a single far beam goes */
    CHECK(smoothed[0] >= ranges[0] && smoothed[0] <= ranges[0] && smoothed[1] >= ranges[1] && smoothed[1] <= ranges[1]);
    CHECK(isinf(smoothed[30]) && smoothed[29] >= ranges[29] && smoothed[29] <= ranges[29]); /* windows with an invalid beam */
    CHECK_NEAR(smoothed[33], 1.1, 1e-6);
}

static void wide_beams_have_smaller_windows(void)
{
    fill(0.5); /* three beams span 1 deg, four would 1.5 */
    CHECK(ek_smooth_ranges(ranges, angles, BEAMS, smoothed));
    CHECK_NEAR(smoothed[10], 1.1, 1e-6); /* 1.1 1.0 1.1 */
    fill(1.0);
    CHECK(!ek_smooth_ranges(ranges, angles, BEAMS, smoothed));
}

static void small_noise_and_short_scans_are_left_alone(void)
{
    fill(0.25);
    for (size_t k = 0; k < BEAMS; k++) {
        ranges[k] = EK_R(2.0) + EK_R(0.01) * ranges[k];
    }
    CHECK(!ek_smooth_ranges(ranges, angles, BEAMS, smoothed));
    for (size_t k = 0; k < BEAMS; k++) { /* without a return there is no noise to estimate */
        ranges[k] = (ek_real)INFINITY;
    }
    CHECK(!ek_smooth_ranges(ranges, angles, BEAMS, smoothed));
    for (size_t alternating = 19u; alternating <= 20u; alternating++) { /* 18 and 20 of 38 neighbours bend */
        fill(0.25);
        for (size_t k = alternating; k < BEAMS; k++) {
            ranges[k] = EK_R(1.0);
        }
        CHECK(ek_smooth_ranges(ranges, angles, BEAMS, smoothed) == (alternating == 20u));
    }
    fill(0.25);
    CHECK(!ek_smooth_ranges(ranges, angles, 4u, smoothed));
    CHECK(!ek_smooth_ranges(ranges, angles, 0u, smoothed));
    angles[3] = (ek_real)NAN; /* two steps of 39 that are not fine; a scan with such an angle is refused later */
    CHECK(ek_smooth_ranges(ranges, angles, BEAMS, smoothed));
}

static void a_lidar_is_noisy_while_most_of_its_last_scans_are(void)
{
    ek_range_noise noise = {EK_R(0.0), 0u};
    const struct {
        int smoothed, count, noisy;
    } told[] = {{1, 1, 1}, {0, 1, 0}, {0, 1, 0}, {1, 2, 1}, {0, 100, 0}}; /* 1 of 1, 1 of 2, 1 of 3, 3 of 5, 3 of 105 */
    for (size_t k = 0; k < sizeof told / sizeof *told; k++) {
        for (int scan = 0; scan < told[k].count; scan++) {
            ek_range_noise_observe(&noise, told[k].smoothed);
        }
        CHECK(ek_is_noisy(&noise) == told[k].noisy);
    }
}

int main(void)
{
    the_median_of_five_fine_beams_is_taken();
    wide_beams_have_smaller_windows();
    small_noise_and_short_scans_are_left_alone();
    a_lidar_is_noisy_while_most_of_its_last_scans_are();
    return verdict();
}

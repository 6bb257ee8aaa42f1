#include "check.h"
#include "ek/speckles.h"

#define BEAMS 18u
#define LOW EK_R(0.1)
#define HIGH EK_R(12.0)

static ek_real ranges[BEAMS], angles[BEAMS], dropped[BEAMS];
static ek_dirt dirt = {EK_R(1.0), 200u}; /* a dirty lidar */

/* A wall at 2 m around the lidar, a beam every 20 deg. */
static void fill(double turn)
{
    for (size_t k = 0; k < BEAMS; k++) {
        angles[k] = EK_R(turn) * EK_PI * ((ek_real)k / EK_R(9.0) - EK_R(1.0));
        ranges[k] = EK_R(2.0);
    }
}

/* Number of speckles among fine beams, 0.1 deg apart: limits of 0.2 m + 0.0087 and 0.0175 times the range. */
static size_t count(void)
{
    for (size_t k = 0; k < BEAMS; k++) {
        angles[k] = EK_PI / EK_R(1800.0) * (ek_real)k;
    }
    return ek_drop_speckles(ranges, angles, BEAMS, LOW, HIGH, &dirt, dropped);
}

static void a_single_beam_before_or_behind_a_wall_is_a_speckle(void)
{
    fill(1.0);
    ranges[5] = EK_R(1.7);
    ranges[12] = EK_R(9.0);
    ranges[16] = EK_R(2.2); /* less than 0.2 m + 0.0087 x 2.2 m away */
    CHECK(count() == 2u);
    CHECK(isnan(dropped[5]) && isnan(dropped[12]));
    for (size_t k = 0; k < BEAMS; k++) {
        CHECK(k == 5u || k == 12u || (dropped[k] >= ranges[k] && dropped[k] <= ranges[k]));
    }
    CHECK(ek_drop_speckles(ranges, angles, BEAMS, LOW, HIGH, &dirt, ranges) == 2u); /* the same array */
    CHECK(isnan(ranges[5]) && isnan(ranges[12]) && ek_drop_speckles(ranges, angles, BEAMS, LOW, HIGH, &dirt, ranges) == 0u);
}

/* The limit grows with the angle to the neighbour. */
static void what_may_be_a_steep_wall_stays(void)
{
    fill(1.0);
    ranges[12] = EK_R(1.0);
    CHECK(ek_drop_speckles(ranges, angles, BEAMS, LOW, HIGH, &dirt, dropped) == 0u); /* 0.2 m + 5 x 0.349 x 1 m */
    ranges[12] = EK_R(0.3);
    CHECK(ek_drop_speckles(ranges, angles, BEAMS, LOW, HIGH, &dirt, dropped) == 1u); /* 1.25 m for the beams 40 deg away */
}

static void two_beams_beside_each_other_stay_and_so_does_the_middle_of_a_slope(void)
{
    fill(1.0);
    ranges[5] = ranges[6] = EK_R(1.0);
    CHECK(count() == 0u);
    ranges[6] = (ek_real)INFINITY; /* beams without a return are no neighbours: 5 and 7 */
    ranges[7] = EK_R(1.0);
    CHECK(count() == 0u);
    fill(1.0);
    for (size_t k = 0; k < BEAMS; k++) { /* a wall that goes away: two neighbours are nearer, two farther */
        ranges[k] = EK_R(1.0) + EK_R(0.45) * (ek_real)(k < 9u ? k : 18u - k);
    }
    CHECK(count() == 2u && isnan(dropped[0]) && isnan(dropped[9])); /* the ends of both walls */
    ranges[5] = EK_R(1.0);
    CHECK(count() == 5u && isnan(dropped[5]) && isnan(dropped[4]) && isnan(dropped[3])); /* takes two of a steep wall along */
}

/* Neighbours are those of the scan as it was, also where they are speckles. */
static void neighbours_may_be_speckles(void)
{
    fill(1.0);
    ranges[4] = EK_R(1.0);
    ranges[5] = EK_R(8.0);
    ranges[6] = EK_R(1.5); /* nearer than 5, 7 and 8, farther than 4 */
    CHECK(count() == 3u && isnan(dropped[4]) && isnan(dropped[5]) && isnan(dropped[6]));
    ranges[3] = EK_R(1.2); /* 4 and 3 lie on one wall; of the neighbours of 6 are 4 and 5 nearer and farther as before */
    CHECK(count() == 2u && isnan(dropped[5]) && isnan(dropped[6]));
    ranges[7] = EK_R(1.0);
    ranges[8] = EK_R(4.0); /* of the neighbours of 6, 4 and 7 are nearer, 5 and 8 farther: it stays */
    CHECK(count() == 3u && isnan(dropped[5]) && isnan(dropped[7]) && isnan(dropped[8]));
}

static void the_first_beam_follows_the_last(void)
{
    for (int backwards = 0; backwards < 2; backwards++) {
        fill(backwards ? -1.0 : 1.0);
        ranges[0] = ranges[17] = EK_R(0.2);
        CHECK(ek_drop_speckles(ranges, angles, BEAMS, LOW, HIGH, &dirt, dropped) == 0u);
        ranges[17] = EK_R(2.0);
        CHECK(ek_drop_speckles(ranges, angles, BEAMS, LOW, HIGH, &dirt, dropped) == 1u && isnan(dropped[0]));
        ranges[0] = EK_R(2.0);
        ranges[17] = EK_R(0.2);
        CHECK(ek_drop_speckles(ranges, angles, BEAMS, LOW, HIGH, &dirt, dropped) == 1u && isnan(dropped[17]));
    }
}

static void invalid_ranges_and_short_scans_are_left_alone(void)
{
    fill(1.0);
    ranges[3] = EK_R(20.0); /* too far, too near, and negative: no hits */
    ranges[9] = EK_R(0.05);
    ranges[10] = EK_R(0.12);
    ranges[15] = -EK_R(2.0);
    CHECK(count() == 1u && isnan(dropped[10]) && isnan(dropped[15]));
    CHECK_NEAR(dropped[3], 20.0, 1e-5);
    CHECK_NEAR(dropped[9], 0.05, 1e-6);
    CHECK(ek_drop_speckles(ranges, angles, 0u, LOW, HIGH, &dirt, dropped) == 0u);
    fill(1.0);
    ranges[0] = EK_R(9.0);
    CHECK(count() == 1u); /* and fine beams */
    for (size_t beams = 1u; beams < 6u; beams++) {
        CHECK(ek_drop_speckles(ranges, angles, beams, LOW, HIGH, &dirt, dropped) == (beams == 5u ? 1u : 0u));
    }
    ranges[0] = -EK_R(0.0); /* a hit where the limits say so */
    CHECK(ek_drop_speckles(ranges, angles, BEAMS, EK_R(0.0), HIGH, &dirt, dropped) == 1u && isnan(dropped[0]));
    angles[2] = (ek_real)NAN; /* refused later */
    CHECK(ek_drop_speckles(ranges, angles, BEAMS, EK_R(0.0), HIGH, &dirt, dropped) == 0u);
}

/* One of 17 hits: after k scans, as if 50 without had gone before, k / (50 + k) / 17; 1.5 % from the 18th on. */
static void a_clean_lidar_keeps_them(void)
{
    ek_dirt now = ek_dirt_default();
    fill(1.0);
    ranges[5] = EK_R(0.2);
    ranges[9] = (ek_real)INFINITY;
    for (uint32_t number = 1u; number <= 400u; number++) {
        const size_t left_out = ek_drop_speckles(ranges, angles, BEAMS, LOW, HIGH, &now, dropped);
        CHECK(left_out == (number < 18u ? 0u : 1u) && (isnan(dropped[5]) != 0) == (number >= 18u));
        CHECK(ek_is_dirty(&now) == (number >= 18u));
        CHECK(now.scans == (number < 150u ? 50u + number : 200u) && isinf(dropped[9]));
        CHECK(number >= 18u || (dropped[5] >= ranges[5] && dropped[5] <= ranges[5]));
    }
    const ek_dirt before = now;
    for (size_t k = 0; k < BEAMS; k++) {
        dropped[k] = (ek_real)NAN;
    }
    CHECK(ek_drop_speckles(dropped, angles, BEAMS, LOW, HIGH, &now, dropped) == 0u); /* without a hit nothing is counted */
    CHECK(memcmp(&before, &now, sizeof now) == 0);
    ranges[5] = EK_R(2.0);
    for (uint32_t number = 0u; number < 400u; number++) {
        ek_drop_speckles(ranges, angles, BEAMS, LOW, HIGH, &now, dropped);
    }
    ranges[5] = EK_R(0.2);
    CHECK(ek_drop_speckles(ranges, angles, BEAMS, LOW, HIGH, &now, dropped) == 0u); /* clean again */
}

int main(void)
{
    a_clean_lidar_keeps_them();
    a_single_beam_before_or_behind_a_wall_is_a_speckle();
    what_may_be_a_steep_wall_stays();
    two_beams_beside_each_other_stay_and_so_does_the_middle_of_a_slope();
    neighbours_may_be_speckles();
    the_first_beam_follows_the_last();
    invalid_ranges_and_short_scans_are_left_alone();
    return verdict();
}

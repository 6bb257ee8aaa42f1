#include "ek/speckles.h"
#include "ek/scan.h"

#define NEAR EK_R(0.2)     /* m: hits whose ranges differ by no more than this, */
#define STEEPEST EK_R(5.0) /* and so many times the distance between their beams, may lie on one wall */
#define DIRTY EK_R(0.015)  /* from this mean share of speckles on a lidar is dirty */
#define MEMORY 200u        /* scans of that mean */
#define CLEAN 50u          /* as if so many clean ones had gone before the first */

/* The range of a beam, a speckle or not; speckles are marked by their sign until all are found. */
static ek_real range_of(const ek_real *marked, size_t beam)
{
    return EK_FABS(marked[beam]);
}

/* 1 if the hit of a beam is a speckle: of the two hits before and the two after it none may lie on a wall with it, and three
 * or all are nearer, or farther. */
static int is_speckle(const ek_real *marked, const ek_real *angles, size_t beams, ek_real low, ek_real high, size_t beam)
{
    const ek_real range = range_of(marked, beam);
    unsigned farther = 0u;
    for (size_t step = 1u, side = 0u; side < 2u; side++, step = beams - 1u) {
        size_t other = beam;
        for (unsigned found = 0u; found < 2u; found++) {
            do {
                other = (other + step) % beams;
            } while (!ek_is_hit(range_of(marked, other), low, high));
            const ek_real beyond = range_of(marked, other) - range, turn = ek_se2_wrap(angles[other] - angles[beam]);
            if (!(EK_FABS(beyond) > NEAR + STEEPEST * range * EK_FABS(turn))) {
                return 0;
            }
            farther += beyond > EK_R(0.0) ? 1u : 0u;
        }
    }
    return farther != 2u;
}

/* 1 if the beam before or after a hit has nearly the same range: most have, and are no speckles. */
static int is_beside(const ek_real *marked, size_t beams, ek_real low, ek_real high, size_t beam)
{
    const ek_real before = range_of(marked, beam > 0u ? beam - 1u : beams - 1u);
    const ek_real after = range_of(marked, beam + 1u < beams ? beam + 1u : 0u);
    return (ek_is_hit(before, low, high) && EK_FABS(before - marked[beam]) <= NEAR) ||
           (ek_is_hit(after, low, high) && EK_FABS(after - marked[beam]) <= NEAR);
}

ek_dirt ek_dirt_default(void)
{
    const ek_dirt dirt = {EK_R(0.0), CLEAN};
    return dirt;
}

int ek_is_dirty(const ek_dirt *dirt)
{
    return dirt->share >= DIRTY;
}

size_t ek_drop_speckles(const ek_real *ranges, const ek_real *angles, size_t beams, ek_real low, ek_real high, ek_dirt *dirt,
                        ek_real *dropped)
{
    size_t hits = 0u, speckles = 0u;
    for (size_t k = 0; k < beams; k++) {
        const ek_real range = ranges[k] + EK_R(0.0); /* -0 has a sign */
        dropped[k] = range < EK_R(0.0) ? (ek_real)NAN : range;
        hits += ek_is_hit(range, low, high) ? 1u : 0u;
    }
    for (size_t k = 0; hits >= 5u && k < beams; k++) {
        if (ek_is_hit(dropped[k], low, high) && !is_beside(dropped, beams, low, high, k) &&
            is_speckle(dropped, angles, beams, low, high, k)) {
            dropped[k] = -dropped[k];
            speckles++;
        }
    }
    if (hits > 0u) {
        dirt->scans += dirt->scans < MEMORY ? 1u : 0u;
        dirt->share += ((ek_real)speckles / (ek_real)hits - dirt->share) / (ek_real)dirt->scans;
    }
    const int stay = !ek_is_dirty(dirt);
    for (size_t k = 0; speckles > 0u && k < beams; k++) {
        dropped[k] = !signbit(dropped[k]) ? dropped[k] : stay ? -dropped[k] : (ek_real)NAN;
    }
    return stay ? 0u : speckles;
}

#include "ek/companions.h"

#include "ek/scan.h"

#define NEAR EK_R(3.0)   /* m: hits farther away stay */
#define MOVED EK_R(0.5)  /* m, or 20 deg: a scan is compared with an earlier one at least so far away */
#define TURNED (EK_R(20.0) * EK_PI / EK_R(180.0))
#define SAME EK_R(0.1)   /* m: a companion keeps its range up to this */
#define FREE EK_R(0.25)  /* m: a place so far before the nearest hit is free; hits so far behind a companion's are its own */
#define MOST EK_R(0.3)   /* if a larger share of the hits would be left out, all stay */
#define LEAST EK_R(0.02) /* companions are left out while this share moved along */
#define OFTEN EK_R(0.7)  /* in this share of the last scans, */
#define MEMORY 10u       /* a mean of so many */
#define SHIFT EK_R(0.29) /* of the borders of sectors, in sectors */
#define TURN (EK_R(2.0) * EK_PI)

/* The sector of an angle; any one of an angle that is not finite. */
static int sector_of(ek_real angle)
{
    const ek_real near = EK_FABS(angle) <= TURN ? angle : ek_se2_wrap(angle);
    const ek_real turned = EK_FABS(near) <= TURN ? near : EK_R(0.0);
    return (ek_floor(turned * ((ek_real)EK_SECTORS / TURN) + SHIFT) + 2 * EK_SECTORS) % EK_SECTORS;
}

static int is_away(const ek_view *earlier, const ek_view *later)
{
    const ek_pose moved = ek_se2_between(earlier->odom_from_sensor, later->odom_from_sensor);
    return EK_SQRT(moved.x * moved.x + moved.y * moved.y) >= MOVED || EK_FABS(moved.theta) >= TURNED;
}

/* 1 if the place at a range in the middle of a sector lies, seen from a view, before all in its sector there and beside it.
 * c, s: cosine and sine of the heading of the sensor. */
static int is_free(const ek_view *view, ek_pose view_from_sensor, ek_real c, ek_real s, int sector, ek_real range)
{
    const ek_real middle = ((ek_real)sector + (EK_R(0.5) - SHIFT)) * (TURN / (ek_real)EK_SECTORS);
    const ek_real along = range * EK_COS(middle), across = range * EK_SIN(middle);
    const ek_real x = c * along - s * across + view_from_sensor.x, y = s * along + c * across + view_from_sensor.y;
    const int at = sector_of(EK_ATAN2(y, x));
    ek_real seen = view->nearest[at];
    for (int step = 1; step < EK_SECTORS; step += EK_SECTORS - 2) {
        const ek_real beside = view->nearest[(at + step) % EK_SECTORS];
        seen = beside < seen ? beside : seen;
    }
    return seen < (ek_real)INFINITY && EK_SQRT(x * x + y * y) < seen - FREE;
}

/* Draw the nearest ranges; returns the number of hits. */
static size_t draw(ek_view *view, const ek_real *ranges, const ek_real *angles, size_t beams, ek_real low, ek_real high)
{
    size_t hits = 0u;
    for (int k = 0; k < EK_SECTORS; k++) {
        view->nearest[k] = (ek_real)INFINITY;
    }
    for (size_t k = 0; k < beams; k++) {
        if (ek_is_hit(ranges[k], low, high)) {
            ek_real *const nearest = &view->nearest[sector_of(angles[k])];
            *nearest = ranges[k] < *nearest ? ranges[k] : *nearest;
            hits++;
        }
    }
    return hits;
}

/* Note which views are kept; the one that is compared with the new one, NULL: none is far enough away. */
static const ek_view *choose(const ek_view *views, ek_company *company, uint32_t now)
{
    const ek_view *const view = &views[now - 1u];
    if (company->older == 0u) {
        company->older = now;
    } else if (company->newer == 0u) {
        company->newer = is_away(&views[company->older - 1u], view) ? now : 0u;
    } else if (is_away(&views[company->newer - 1u], view)) {
        company->older = company->newer;
        company->newer = now;
    }
    const ek_view *const older = &views[company->older - 1u];
    return is_away(older, view) ? older : NULL;
}

/* Mark the sectors in which something moved along; returns their number. */
static int find(const ek_view *now, const ek_view *earlier, unsigned char *companions)
{
    const ek_pose earlier_from_now = ek_se2_between(earlier->odom_from_sensor, now->odom_from_sensor);
    const ek_pose now_from_earlier = ek_se2_inverse(earlier_from_now);
    const ek_real c = EK_COS(earlier_from_now.theta), s = EK_SIN(earlier_from_now.theta);
    int marked = 0;
    for (int k = 0; k < EK_SECTORS; k++) {
        const ek_real range = now->nearest[k], before = earlier->nearest[k];
        companions[k] = range <= NEAR && EK_FABS(before - range) <= SAME &&
                        (is_free(earlier, earlier_from_now, c, s, k, range) ||
                         is_free(now, now_from_earlier, c, -s, k, before));
        marked += companions[k];
    }
    return marked;
}

/* 1 if a beam hits what moved along, or what lies close behind it. */
static int is_own(const ek_view *view, const unsigned char *companions, ek_real range, ek_real angle, ek_real low, ek_real high)
{
    const int sector = ek_is_hit(range, low, high) ? sector_of(angle) : -1;
    return sector >= 0 && companions[sector] && range - view->nearest[sector] <= FREE;
}

size_t ek_drop_companions(ek_view *views, ek_company *company, ek_real *ranges, const ek_real *angles, size_t beams, ek_real low,
                          ek_real high, ek_pose odom_from_sensor)
{
    unsigned char companions[EK_SECTORS];
    size_t own = 0u;
    uint32_t now = 1u;
    while (now == company->older || now == company->newer) {
        now++;
    }
    ek_view *const view = &views[now - 1u];
    const size_t hits = draw(view, ranges, angles, beams, low, high);
    view->odom_from_sensor = odom_from_sensor;
    const ek_view *const earlier = choose(views, company, now);
    if (!earlier || hits == 0u) {
        return 0u;
    }
    if (find(view, earlier, companions)) {
        for (size_t k = 0; k < beams; k++) {
            own += is_own(view, companions, ranges[k], angles[k], low, high) ? 1u : 0u;
        }
    }
    const ek_real share = (ek_real)own / (ek_real)hits;
    const ek_real some = share >= LEAST && share <= MOST ? EK_R(1.0) : EK_R(0.0);
    company->scans += company->scans < MEMORY ? 1u : 0u;
    company->often += (some - company->often) / (ek_real)company->scans;
    if (own == 0u || company->often < OFTEN || share > MOST) {
        return 0u;
    }
    for (size_t k = 0; k < beams; k++) {
        ranges[k] = is_own(view, companions, ranges[k], angles[k], low, high) ? (ek_real)NAN : ranges[k];
    }
    return own;
}

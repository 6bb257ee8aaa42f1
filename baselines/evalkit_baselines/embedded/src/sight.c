#include "ek/sight.h"

#define GAP (EK_R(5.0) * EK_PI / EK_R(180.0)) /* a direction farther than this from every point was not seen */

/* Sort the rays by bearing: merge runs of doubling length; stable. */
static void sort_rays(ek_sight *sight)
{
    const size_t count = sight->rays;
    for (size_t width = 1u; width < count; width *= 2u) {
        const ek_sight_ray *const from = sight->ray;
        ek_sight_ray *const to = sight->other;
        for (size_t start = 0u; start < count; start += 2u * width) {
            const size_t middle = start + width < count ? start + width : count;
            const size_t end = middle + width < count ? middle + width : count;
            size_t i = start, j = middle;
            for (size_t k = start; k < end; k++) {
                const int left = i < middle && (j >= end || from[i].bearing <= from[j].bearing);
                to[k] = left ? from[i++] : from[j++];
            }
        }
        sight->other = sight->ray;
        sight->ray = to;
    }
}

/* The ray next to a bearing, and how far it is from it (rad). */
static ek_sight_ray nearest_ray(const ek_sight *sight, ek_real bearing, ek_real *gap)
{
    const ek_sight_ray *const ray = sight->ray;
    const size_t count = sight->rays;
    size_t low = 0u, high = count; /* the first ray that is not before the bearing */
    while (low < high) {
        const size_t middle = (low + high) / 2u;
        if (ray[middle].bearing < bearing) {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    const ek_real turn = EK_R(2.0) * EK_PI;
    const ek_sight_ray left = low > 0u ? ray[low - 1u] : ray[count - 1u], right = low < count ? ray[low] : ray[0];
    const ek_real before = bearing - (low > 0u ? left.bearing : left.bearing - turn);
    const ek_real after = (low < count ? right.bearing : right.bearing + turn) - bearing;
    *gap = before < after ? before : after;
    return before < after ? left : right;
}

void ek_sight_take(ek_sight *sight, const ek_real *xy, size_t count, ek_real x, ek_real y)
{
    for (size_t i = 0; i < count; i++) {
        const ek_real dx = xy[2u * i] - x, dy = xy[2u * i + 1u] - y;
        sight->ray[i].bearing = EK_ATAN2(dy, dx);
        sight->ray[i].range = EK_SQRT(dx * dx + dy * dy);
    }
    sight->rays = count;
    sort_rays(sight);
}

int ek_sight_could_see(const ek_sight *sight, ek_real x, ek_real y, ek_real behind)
{
    ek_real gap;
    if (sight->rays == 0u) {
        return 0;
    }
    const ek_sight_ray ray = nearest_ray(sight, EK_ATAN2(y, x), &gap);
    return gap <= GAP && EK_SQRT(x * x + y * y) <= ray.range + behind;
}

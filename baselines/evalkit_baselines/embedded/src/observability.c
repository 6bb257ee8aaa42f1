#include "ek/observability.h"
#include "ek/normals.h"

#include <string.h>

#define BLIND EK_R(0.045) /* ratios of eigenvalues: as in the reference */
#define SEEING EK_R(0.065)
#define VOXEL EK_R(0.1)
#define NEIGHBOURS 8u
#define SAMPLES 100u      /* points whose normals are measured: every n-th, so that so many are left, less than twice as many */
#define NORMAL_WORK 160u /* operations of the normal of one point, */
#define INDEX_WORK 20u   /* and of a point of the index */
#define CELLS_PER_POINT 16u
#define MAX_CELLS ((size_t)1 << 16)

ek_status ek_observer_init(ek_observer *observer, ek_arena *arena, size_t capacity)
{
    if (!observer || !arena) {
        return EK_NULL_POINTER;
    }
    memset(observer, 0, sizeof *observer);
    const size_t cells = capacity < MAX_CELLS / CELLS_PER_POINT ? CELLS_PER_POINT * capacity : MAX_CELLS;
    const ek_status status = ek_index_init(&observer->index, arena, capacity, cells);
    observer->thinned = (ek_real *)ek_arena_alloc(arena, capacity, 2u * sizeof(ek_real));
    observer->normals = (ek_real *)ek_arena_alloc(arena, capacity, 2u * sizeof(ek_real));
    return status;
}

ek_openness ek_observer_measure(ek_observer *observer, ek_thinner *thinner, const ek_real *xy, size_t count,
                                ek_real reach, ek_work *work)
{
    ek_openness open = {EK_R(1.0), EK_R(0.0), EK_R(0.0)};
    const size_t cells = ek_thin(thinner, xy, count, VOXEL, observer->thinned, work);
    const uint32_t every = cells / SAMPLES > 1u ? (uint32_t)(cells / SAMPLES) : 1u;
    if (cells < NEIGHBOURS) {
        return open;
    }
    ek_index_build(&observer->index, observer->thinned, cells);
    ek_normals_defer(&observer->index, NEIGHBOURS, observer->normals);
    ek_real first = observer->index.cells.cell;
    for (uint32_t slot = 0; slot < cells; slot++) {
        if (observer->index.id[slot] % every == 0u) {
            ek_normals_ensure(&observer->index, slot, &first);
        }
    }
    ek_work_spend(work, INDEX_WORK * (uint64_t)cells + NORMAL_WORK * (uint64_t)(cells / every + 1u));
    ek_real xx = EK_R(0.0), xy_sum = EK_R(0.0), yy = EK_R(0.0);
    size_t near = 0u;
    for (size_t k = 0; k < cells; k += every) {
        const ek_real x = observer->thinned[2u * k], y = observer->thinned[2u * k + 1u];
        if (x * x + y * y > reach * reach) {
            continue;
        }
        const ek_real u = observer->normals[2u * k], v = observer->normals[2u * k + 1u];
        near++;
        xx += u * u;
        xy_sum += u * v;
        yy += v * v;
    }
    if (near < NEIGHBOURS) {
        return open;
    }
    const ek_real mean = EK_R(0.5) * (xx + yy), half = EK_R(0.5) * (xx - yy);
    const ek_real radius = EK_SQRT(half * half + xy_sum * xy_sum), low = mean - radius;
    /* eigenvector of the smaller eigenvalue: across the direction of the larger one */
    const ek_real angle = EK_R(0.5) * EK_ATAN2(xy_sum, half);
    open.x = -EK_SIN(angle);
    open.y = EK_COS(angle);
    open.ratio = (low > EK_R(0.0) ? low : EK_R(0.0)) / (mean + radius);
    return open;
}

ek_real ek_openness_trust(const ek_openness *open)
{
    const ek_real trust = (open->ratio - BLIND) / (SEEING - BLIND);
    return trust < EK_R(0.0) ? EK_R(0.0) : trust < EK_R(1.0) ? trust : EK_R(1.0);
}

ek_pose ek_openness_limit(const ek_openness *open, ek_pose match, ek_pose guess)
{
    const ek_real trust = ek_openness_trust(open), c = EK_COS(match.theta), s = EK_SIN(match.theta);
    if (trust >= EK_R(1.0)) {
        return match;
    }
    const ek_real u = c * open->x - s * open->y, v = s * open->x + c * open->y;
    const ek_real x = match.x - guess.x, y = match.y - guess.y;
    const ek_real along = (EK_R(1.0) - trust) * (x * u + y * v);
    match.x = guess.x + x - along * u;
    match.y = guess.y + y - along * v;
    return match;
}

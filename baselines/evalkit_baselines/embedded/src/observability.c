#include "ek/observability.h"
#include "ek/normals.h"

#include <string.h>

#define BLIND EK_R(0.045) /* ratios of eigenvalues: as in the reference */
#define SEEING EK_R(0.065)
#define ROUND EK_R(0.15) /* m */
#define FIXED EK_R(0.3)
#define RIDGE EK_R(1e-4)
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

/* The place that the lines of the normals pass most closely, by their scatter, moments (g, h) and squared moments: a turn about
 * it moves no point of a circle along its normal. */
static void find_open_turn(ek_real xx, ek_real xy, ek_real yy, ek_real g, ek_real h, ek_real moments, ek_real count,
                           ek_openness *open)
{
    const ek_real ridge = RIDGE * count, a = yy + ridge, b = xx + ridge, det = a * b - xy * xy;
    open->centre_x = (b * g + xy * h) / det;
    open->centre_y = (a * h + xy * g) / det;
    const ek_real squared = (moments - open->centre_x * g - open->centre_y * h) / count;
    const ek_real share = (FIXED - EK_SQRT(squared > EK_R(0.0) ? squared : EK_R(0.0))) / (FIXED - ROUND);
    open->open_turn = share < EK_R(0.0) ? EK_R(0.0) : share < EK_R(1.0) ? share : EK_R(1.0);
}

ek_openness ek_observer_measure(ek_observer *observer, ek_thinner *thinner, const ek_real *xy, size_t count,
                                ek_real reach, ek_work *work)
{
    ek_openness open = {.x = EK_R(1.0)};
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
    ek_real g = EK_R(0.0), h = EK_R(0.0), moments = EK_R(0.0);
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
        const ek_real moment = x * v - y * u; /* of the normal's line about the origin */
        g += moment * v;
        h -= moment * u;
        moments += moment * moment;
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
    find_open_turn(xx, xy_sum, yy, g, h, moments, (ek_real)near, &open);
    return open;
}

ek_real ek_openness_trust(const ek_openness *open)
{
    const ek_real trust = (open->ratio - BLIND) / (SEEING - BLIND);
    return trust < EK_R(0.0) ? EK_R(0.0) : trust < EK_R(1.0) ? trust : EK_R(1.0);
}

int ek_openness_is_closed(const ek_openness *open)
{
    return open->ratio >= SEEING && open->open_turn == EK_R(0.0);
}

/* Turn a pose towards the heading of a guess about the centre of the open turn. */
static ek_pose turn_back(const ek_openness *open, ek_pose pose, ek_pose guess)
{
    const ek_real x = open->centre_x, y = open->centre_y, c = EK_COS(pose.theta), s = EK_SIN(pose.theta);
    const ek_real theta = pose.theta - open->open_turn * ek_se2_wrap(pose.theta - guess.theta);
    const ek_real turned_c = EK_COS(theta), turned_s = EK_SIN(theta);
    const ek_pose turned = {pose.x + (c - turned_c) * x - (s - turned_s) * y, pose.y + (s - turned_s) * x + (c - turned_c) * y, theta};
    return turned;
}

ek_pose ek_openness_limit(const ek_openness *open, ek_pose match, ek_pose guess)
{
    if (open->open_turn > EK_R(0.0)) {
        match = turn_back(open, match, guess);
    }
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

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

void ek_observer_take(ek_observer *observer, ek_thinner *thinner, const ek_real *xy, size_t count, ek_work *work)
{
    const size_t cells = observer->cells = ek_thin(thinner, xy, count, VOXEL, observer->thinned, work);
    const size_t every = observer->every = cells / SAMPLES > 1u ? cells / SAMPLES : 1u;
    if (cells < NEIGHBOURS) {
        observer->cells = 0u; /* too few: they have no normals */
        return;
    }
    ek_index_build(&observer->index, observer->thinned, cells);
    ek_normals_defer(&observer->index, NEIGHBOURS, observer->normals);
    ek_real first = observer->index.cells.cell;
    for (uint32_t slot = 0; slot < cells; slot++) {
        if (observer->index.id[slot] % every == 0u) {
            ek_normals_ensure(&observer->index, slot, &first);
        }
    }
    ek_work_spend_tallied(work, INDEX_WORK * (uint64_t)cells + NORMAL_WORK * (uint64_t)(cells / every + 1u));
}

/* Sums over points p with normals n: scatter n n', moments m = p x n, and m n turned by -90 degrees. */
typedef struct {
    ek_real xx, xy, yy, turned_x, turned_y, squared;
    size_t count;
} sums;

static void add_point(sums *sum, const ek_real *point, const ek_real *normal)
{
    const ek_real u = normal[0], v = normal[1], moment = point[0] * v - point[1] * u;
    sum->count++;
    sum->xx += u * u;
    sum->xy += u * v;
    sum->yy += v * v;
    sum->turned_x += moment * v;
    sum->turned_y -= moment * u;
    sum->squared += moment * moment;
}

/* The place that the lines of the normals pass most closely: a turn about it moves no point of a circle along its normal. */
static void find_open_turn(const sums *sum, ek_openness *open)
{
    const ek_real count = (ek_real)sum->count, a = sum->yy + RIDGE * count, b = sum->xx + RIDGE * count;
    const ek_real det = a * b - sum->xy * sum->xy;
    open->centre_x = (b * sum->turned_x + sum->xy * sum->turned_y) / det;
    open->centre_y = (a * sum->turned_y + sum->xy * sum->turned_x) / det;
    const ek_real squared =
        (sum->squared - open->centre_x * sum->turned_x - open->centre_y * sum->turned_y) / count;
    const ek_real share = (FIXED - EK_SQRT(squared > EK_R(0.0) ? squared : EK_R(0.0))) / (FIXED - ROUND);
    open->open_turn = share < EK_R(0.0) ? EK_R(0.0) : share < EK_R(1.0) ? share : EK_R(1.0);
}

static ek_openness openness_of(const sums *sum)
{
    ek_openness open = {.x = EK_R(1.0)};
    if (sum->count < NEIGHBOURS) {
        return open;
    }
    const ek_real mean = EK_R(0.5) * (sum->xx + sum->yy), half = EK_R(0.5) * (sum->xx - sum->yy);
    const ek_real radius = EK_SQRT(half * half + sum->xy * sum->xy), low = mean - radius;
    /* eigenvector of the smaller eigenvalue: across the direction of the larger one */
    const ek_real angle = EK_R(0.5) * EK_ATAN2(sum->xy, half);
    open.x = -EK_SIN(angle);
    open.y = EK_COS(angle);
    open.ratio = (low > EK_R(0.0) ? low : EK_R(0.0)) / (mean + radius);
    find_open_turn(sum, &open);
    return open;
}

ek_openness ek_observer_measure(const ek_observer *observer, ek_real reach)
{
    sums sum = {.count = 0u};
    for (size_t k = 0; k < observer->cells; k += observer->every) {
        const ek_real *const point = &observer->thinned[2u * k];
        if (point[0] * point[0] + point[1] * point[1] <= reach * reach) {
            add_point(&sum, point, &observer->normals[2u * k]);
        }
    }
    return openness_of(&sum);
}

ek_openness ek_observer_measure_on(const ek_observer *observer, const ek_index *target, ek_pose pose, ek_real limit)
{
    const ek_real c = EK_COS(pose.theta), s = EK_SIN(pose.theta);
    sums sum = {.count = 0u};
    for (size_t k = 0; k < observer->cells && target->count > 0u; k += observer->every) {
        const ek_real x = observer->thinned[2u * k], y = observer->thinned[2u * k + 1u];
        const ek_neighbour nearest =
            ek_index_nearest(target, c * x - s * y + pose.x, s * x + c * y + pose.y, limit, limit);
        if (nearest.slot != EK_NONE) {
            add_point(&sum, &observer->thinned[2u * k], &observer->normals[2u * k]);
        }
    }
    return openness_of(&sum);
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

int ek_openness_is_room(const ek_openness *open)
{
    return open->ratio >= EK_ROOM_RATIO && open->open_turn == EK_R(0.0);
}

/* Turn a pose towards the heading of a guess about the centre of the open turn. */
static ek_pose turn_back(const ek_openness *open, ek_pose pose, ek_pose guess)
{
    const ek_real x = open->centre_x, y = open->centre_y, c = EK_COS(pose.theta), s = EK_SIN(pose.theta);
    const ek_real theta = pose.theta - open->open_turn * ek_se2_wrap(pose.theta - guess.theta);
    const ek_real turned_c = EK_COS(theta), turned_s = EK_SIN(theta);
    const ek_pose turned = {pose.x + (c - turned_c) * x - (s - turned_s) * y, pose.y + (s - turned_s) * x + (c - turned_c) * y,
                            theta};
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

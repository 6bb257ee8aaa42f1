#include "ek/keyframes.h"

#include <string.h>

#define CLOSURE_LENGTH EK_R(0.5) /* m that a loop adds to the distance through the graph */
#define OPEN_FACTOR EK_R(20.0)   /* variance along the walls of a bare corridor, as a multiple of that in a room */
#define BLIND EK_R(0.045)
#define MIN_LENGTH EK_R(0.05) /* m */
#define STILL EK_R(1e-9)      /* m: length of a step without motion */
#define LOST EK_R(0.5)        /* m, and 10 deg: 1 sigma of a step by wheel odometry alone where the track was lost */
#define LOST_THETA (EK_R(10.0) * EK_PI / EK_R(180.0))

static const ek_sym3 UNKNOWN = {EK_R(1e-4), EK_R(0.0), EK_R(0.0), EK_R(1e-4), EK_R(0.0), EK_R(1e-2)};

ek_status ek_keyframes_init(ek_keyframes *keyframes, ek_arena *arena, size_t capacity, size_t points, size_t loops,
                            ek_drift drift)
{
    if (!keyframes || !arena) {
        return EK_NULL_POINTER;
    }
    if (points == 0u || points > (size_t)1 << 30 || !(drift.sigma > EK_R(0.0)) || !(drift.sigma_theta > EK_R(0.0)) ||
        !isfinite(drift.sigma) || !isfinite(drift.sigma_theta)) {
        return EK_OUT_OF_RANGE;
    }
    memset(keyframes, 0, sizeof *keyframes);
    keyframes->capacity = capacity;
    keyframes->point_capacity = points;
    keyframes->drift = drift;
    const ek_status status = ek_pose_graph_init(&keyframes->graph, arena, capacity, loops);
    if (status != EK_OK) {
        return status;
    }
    keyframes->points = (ek_real *)ek_arena_alloc(arena, points, 2u * sizeof(ek_real));
    keyframes->sensor = (ek_real *)ek_arena_alloc(arena, capacity, 2u * sizeof(ek_real));
    keyframes->start = (size_t *)ek_arena_alloc(arena, capacity + 1u, sizeof(size_t));
    keyframes->path = (ek_real *)ek_arena_alloc(arena, capacity, sizeof(ek_real));
    keyframes->apart = (ek_real *)ek_arena_alloc(arena, capacity, sizeof(ek_real));
    keyframes->section = (uint32_t *)ek_arena_alloc(arena, capacity, sizeof(uint32_t));
    keyframes->kind = (uint8_t *)ek_arena_alloc(arena, capacity, sizeof(uint8_t));
    return EK_OK;
}

/* Information of a step over a path, in the frame of the scan at its end. */
static ek_sym3 step_information(const ek_drift *drift, ek_real path, const ek_openness *open, ek_doubt doubt)
{
    const ek_real length = path > MIN_LENGTH ? path : MIN_LENGTH, part = (EK_ROOM_RATIO - open->ratio) / (EK_ROOM_RATIO - BLIND);
    const ek_real share = part < EK_R(0.0) ? EK_R(0.0) : part < EK_R(1.0) ? part : EK_R(1.0);
    const ek_real variance = drift->sigma * drift->sigma * length, more = variance * OPEN_FACTOR * share;
    const ek_real position = variance + doubt.position;
    const ek_sym3 covariance = {position + more * open->x * open->x, more * open->x * open->y,
                                EK_R(0.0), position + more * open->y * open->y,
                                EK_R(0.0), drift->sigma_theta * drift->sigma_theta * length + doubt.heading};
    ek_sym3 information = UNKNOWN;
    ek_sym3_inverse(&covariance, &information);
    return information;
}

/* Length of a step through the graph. */
static ek_real graph_length(ek_step_kind kind, ek_real length)
{
    return kind == EK_STEP_MATCHED ? length : kind == EK_STEP_MEASURED ? EK_DOUBTED : EK_APART;
}

ek_status ek_keyframes_add(ek_keyframes *keyframes, const ek_real *xy, size_t count, const ek_real *sensor,
                           ek_pose last_from_keyframe, ek_step_kind kind, const ek_openness *open, ek_doubt doubt, ek_work *work)
{
    const size_t row = keyframes->count, used = row ? keyframes->start[row] : 0u;
    if (row == keyframes->capacity || count > keyframes->point_capacity - used) {
        return EK_TOO_MANY_POINTS;
    }
    const ek_real x = last_from_keyframe.x, y = last_from_keyframe.y, length = EK_SQRT(x * x + y * y);
    if (kind == EK_STEP_MEASURED) {
        doubt.position += LOST * LOST;
        doubt.heading += LOST_THETA * LOST_THETA;
    }
    const ek_sym3 information =
        kind == EK_STEP_UNKNOWN ? UNKNOWN : step_information(&keyframes->drift, length, open, doubt);
    const ek_status status = ek_pose_graph_add(&keyframes->graph, last_from_keyframe, &information);
    if (status != EK_OK) {
        return status;
    }
    for (size_t k = 0; k < row; k++) {
        const ek_real apart = keyframes->apart[k] + graph_length(kind, length);
        keyframes->apart[k] = apart < EK_APART ? apart : EK_APART;
    }
    memcpy(keyframes->points + 2u * used, xy, 2u * count * sizeof *xy);
    keyframes->sensor[2u * row] = sensor[0];
    keyframes->sensor[2u * row + 1u] = sensor[1];
    keyframes->start[row] = used;
    keyframes->start[row + 1u] = used + count;
    keyframes->path[row] = (row ? keyframes->path[row - 1u] : EK_R(0.0)) + length;
    keyframes->apart[row] = EK_R(0.0);
    keyframes->section[row] = row ? keyframes->section[row - 1u] + (kind != EK_STEP_MATCHED) : 0u;
    keyframes->kind[row] = (uint8_t)kind;
    keyframes->count++;
    ek_work_spend(work, row + count);
    return EK_OK;
}

static int shorten(ek_real *distance, ek_real other)
{
    const int shorter = other < *distance;
    *distance = shorter ? other : *distance;
    return shorter;
}

static ek_real step_length(const ek_keyframes *keyframes, size_t row)
{
    return graph_length((ek_step_kind)keyframes->kind[row], keyframes->path[row] - keyframes->path[row - 1u] + STILL);
}

void ek_keyframes_measure(ek_keyframes *keyframes, ek_work *work)
{
    const ek_pose_graph *const graph = &keyframes->graph;
    ek_real *const apart = keyframes->apart;
    const size_t last = keyframes->count - 1u;
    for (size_t k = 0; k < last; k++) {
        apart[k] = EK_APART;
    }
    apart[last] = EK_R(0.0);
    for (int changed = 1; changed;) { /* no shortest way takes a loop twice: one pass a loop, and one that changes nothing */
        changed = 0;
        for (size_t k = last; k > 0u; k--) {
            shorten(apart + k - 1u, apart[k] + step_length(keyframes, k));
        }
        for (size_t k = 1; k <= last; k++) {
            shorten(apart + k, apart[k - 1u] + step_length(keyframes, k));
        }
        for (size_t l = 0; l < graph->loop_count; l++) {
            const ek_loop_edge *const loop = graph->loop + l;
            changed |= shorten(apart + loop->first, apart[loop->second] + CLOSURE_LENGTH);
            changed |= shorten(apart + loop->second, apart[loop->first] + CLOSURE_LENGTH);
        }
        ek_work_spend(work, 2u * (uint64_t)last + graph->loop_count);
    }
}

void ek_keyframes_join(ek_keyframes *keyframes, const ek_loop_edge *loop, int contradicts, ek_work *work)
{
    ek_pose *const pose = keyframes->graph.pose;
    const ek_pose before = pose[loop->second];
    const ek_pose after = ek_se2_compose(pose[loop->first], loop->first_from_second);
    for (size_t k = 0; k < keyframes->count; k++) {
        const int moves = keyframes->apart[k] < EK_DOUBTED;
        if (moves) {
            pose[k] = ek_se2_compose(after, ek_se2_between(before, pose[k]));
        }
        if (contradicts && k && moves != (keyframes->apart[k - 1u] < EK_DOUBTED)) {
            keyframes->kind[k] = EK_STEP_UNKNOWN;
            keyframes->graph.step[k].information = UNKNOWN;
        }
    }
    ek_work_spend(work, EK_MOVE_WORK * (uint64_t)keyframes->count);
}

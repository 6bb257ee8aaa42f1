#include "ek/scan.h"
#include "ek/tally.h"

#include <string.h>

#define MAX_COUNT ((size_t)1 << 30)
#define MAX_DISTANCE EK_R(1000.0) /* m */
#define PER(number) (EK_R(1.0) / EK_R(number))
#define SMALL_TURN EK_R(0.1)  /* rad per scan: below, a short series is exact */

ek_status ek_scan_check(const ek_scan_parameters *parameters)
{
    if (!parameters) {
        return EK_NULL_POINTER;
    }
    if (!ek_se2_is_finite(parameters->base_from_sensor) || !isfinite(parameters->range_min) ||
        !isfinite(parameters->range_max) || !isfinite(parameters->local_radius)) {
        return EK_NOT_FINITE;
    }
    if (parameters->range_min < EK_R(0.0) || parameters->range_min >= parameters->range_max ||
        parameters->range_max > MAX_DISTANCE || parameters->local_radius < EK_R(0.0)) {
        return EK_OUT_OF_RANGE;
    }
    return EK_OK;
}

ek_status ek_scan_init(ek_scan *scan, ek_arena *arena, size_t capacity)
{
    if (!scan || !arena) {
        return EK_NULL_POINTER;
    }
    if (capacity == 0u || capacity > MAX_COUNT) {
        return EK_OUT_OF_RANGE;
    }
    memset(scan, 0, sizeof *scan);
    scan->capacity = capacity;
    scan->hits = (ek_real *)ek_arena_alloc(arena, 2u * capacity, sizeof(ek_real));
    scan->ends = (ek_real *)ek_arena_alloc(arena, 2u * capacity, sizeof(ek_real));
    scan->angle = (ek_real *)ek_arena_alloc(arena, capacity, sizeof(ek_real));
    scan->cosine = (ek_real *)ek_arena_alloc(arena, capacity, sizeof(ek_real));
    scan->sine = (ek_real *)ek_arena_alloc(arena, capacity, sizeof(ek_real));
    if (arena->memory && ek_arena_check(arena) == EK_OK) {
        for (size_t i = 0; i < capacity; i++) {
            scan->angle[i] = EK_R(0.0);
            scan->cosine[i] = EK_R(1.0);
            scan->sine[i] = EK_R(0.0);
        }
    }
    return EK_OK;
}

/* A constant-velocity motion. */
typedef struct {
    ek_real theta, vx, vy; /* rad; translation of the logarithm (m) */
    int moves;
} ek_arc;

static ek_arc make_arc(const ek_pose *motion)
{
    ek_arc arc = {EK_R(0.0), EK_R(0.0), EK_R(0.0), 0};
    if (motion) {
        const ek_real half = EK_R(0.5) * motion->theta;
        const ek_real cot = EK_FABS(half) < EK_R(1e-5) ? EK_R(1.0) - half * half / EK_R(3.0) : half / EK_TAN(half);
        arc.theta = motion->theta;
        arc.vx = cot * motion->x + half * motion->y;
        arc.vy = -half * motion->x + cot * motion->y;
        arc.moves = 1;
    }
    return arc;
}

/* Move a point along a share of the arc: exponential with (s, c1) = (sin, 1 - cos) / theta. */
static void move_along_arc(const ek_arc *arc, ek_real share, ek_real *x, ek_real *y)
{
    const ek_real a = share * arc->theta, a2 = a * a;
    ek_real s, c1;
    if (EK_FABS(arc->theta) < SMALL_TURN) {
        s = share * (EK_R(1.0) - a2 * PER(6.0) * (EK_R(1.0) - a2 * PER(20.0) * (EK_R(1.0) - a2 * PER(42.0))));
        c1 = share * a * EK_R(0.5) *
             (EK_R(1.0) - a2 * PER(12.0) * (EK_R(1.0) - a2 * PER(30.0) * (EK_R(1.0) - a2 * PER(56.0))));
    } else {
        const ek_real half_sine = EK_SIN(EK_R(0.5) * a);
        s = EK_SIN(a) / arc->theta;
        c1 = EK_R(2.0) * half_sine * half_sine / arc->theta;
    }
    const ek_real sine = arc->theta * s, cosine = EK_R(1.0) - arc->theta * c1;
    const ek_real moved_x = cosine * *x - sine * *y + (s * arc->vx - c1 * arc->vy);
    *y = sine * *x + cosine * *y + (c1 * arc->vx + s * arc->vy);
    *x = moved_x;
}

/* Add the end point of a beam without return: its direction turns with the base, its origin does not move. */
static void add_miss(ek_scan *scan, size_t beam, const ek_scan_parameters *parameters, ek_real turned)
{
    const ek_pose *const mount = &parameters->base_from_sensor;
    const ek_real angle = mount->theta + scan->angle[beam] + turned;
    const ek_real x = mount->x + parameters->range_max * EK_COS(angle);
    const ek_real y = mount->y + parameters->range_max * EK_SIN(angle);
    scan->ends[2u * scan->misses] = x;
    scan->ends[2u * scan->misses + 1u] = y;
    scan->misses += isfinite(x) && isfinite(y) ? 1u : 0u; /* a sum of finite angles may be infinite */
}

static ek_status update_directions(ek_scan *scan, const ek_sweep *sweep)
{
    for (size_t i = 0; i < sweep->beams; i++) {
        const ek_real angle = sweep->angles[i];
        if (angle != scan->angle[i]) {
            if (!isfinite(angle)) {
                return EK_NOT_FINITE;
            }
            scan->angle[i] = angle;
            scan->cosine[i] = EK_COS(angle);
            scan->sine[i] = EK_SIN(angle);
        }
    }
    return EK_OK;
}

static ek_status check(ek_scan *scan, const ek_sweep *sweep, const ek_scan_parameters *parameters,
                       const ek_pose *start_from_end)
{
    if (!scan || !sweep || !parameters || !sweep->ranges || !sweep->angles) {
        return EK_NULL_POINTER;
    }
    scan->count = scan->misses = 0u;
    if (sweep->beams == 0u) {
        return EK_NO_POINTS;
    }
    if (sweep->beams > scan->capacity) {
        return EK_TOO_MANY_POINTS;
    }
    if (start_from_end && !ek_se2_is_finite(*start_from_end)) {
        return EK_NOT_FINITE;
    }
    const ek_status status = ek_scan_check(parameters);
    return status == EK_OK ? update_directions(scan, sweep) : status;
}

ek_status ek_scan_project(ek_scan *scan, const ek_sweep *sweep, const ek_scan_parameters *parameters,
                          const ek_pose *start_from_end)
{
    const ek_status status = check(scan, sweep, parameters, start_from_end);
    if (status != EK_OK) {
        return status;
    }
    EK_COUNT(EK_BEAMS, sweep->beams);
    const ek_pose mount = parameters->base_from_sensor;
    const ek_real c = EK_COS(mount.theta), s = EK_SIN(mount.theta);
    const ek_arc arc = make_arc(sweep->beams > 1u ? start_from_end : NULL);
    const ek_real per_beam = sweep->beams > 1u ? EK_R(1.0) / (ek_real)(sweep->beams - 1u) : EK_R(0.0);
    const int local = parameters->local_radius > EK_R(0.0) && parameters->local_radius < EK_MAX_COORDINATE;
    const ek_real radius = local ? parameters->local_radius : EK_MAX_COORDINATE;
    for (size_t i = 0; i < sweep->beams; i++) {
        const ek_real range = sweep->ranges[i];
        if (ek_is_hit(range, parameters->range_min, parameters->range_max)) {
            const ek_real u = range * scan->cosine[i], v = range * scan->sine[i];
            ek_real x = c * u - s * v + mount.x, y = s * u + c * v + mount.y;
            if (arc.moves) {
                move_along_arc(&arc, (ek_real)i * per_beam, &x, &y);
            }
            scan->hits[2u * scan->count] = x;
            scan->hits[2u * scan->count + 1u] = y;
            scan->count += x * x + y * y <= radius * radius ? 1u : 0u;
        } else if (isinf(range) && range > EK_R(0.0)) {
            add_miss(scan, i, parameters, arc.theta * (ek_real)i * per_beam);
        }
    }
    return EK_OK;
}

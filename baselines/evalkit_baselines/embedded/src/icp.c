#include "ek/icp.h"
#include "ek/fit.h"
#include "ek/normals.h"
#include "ek/table.h"
#include "ek/tally.h"

#include <string.h>

#define MAX_COUNT ((size_t)1 << 30)
#define FIRST_LOOK EK_R(0.75) /* cells: half width of the first search without a known neighbour */
#define BEYOND EK_R(0.25)     /* cells: searched beyond the last neighbour; saves later searches */
#define ROUNDED_DOWN (EK_R(1.0) - EK_R(8.0) * EK_EPSILON)
#define MAX_DISTANCE EK_R(1e12) /* m; below EK_FAR: stands for "no limit" */

ek_icp_parameters ek_icp_default(void)
{
    ek_icp_parameters parameters;
    parameters.max_iterations = 40;
    parameters.min_pairs = 3;
    parameters.epsilon = EK_R(1e-4);
    parameters.max_correspondence = EK_R(0.3);
    parameters.error = EK_ERROR_MEAN;
    parameters.error_before = 0;
    parameters.one_to_one = 1;
    parameters.metric = EK_METRIC_POINT;
    parameters.cauchy = EK_R(0.0);
    return parameters;
}

ek_status ek_icp_check(const ek_icp_parameters *parameters)
{
    if (!parameters) {
        return EK_NULL_POINTER;
    }
    if (parameters->max_iterations < 1 || parameters->min_pairs < 2 ||
        (unsigned)parameters->error > (unsigned)EK_ERROR_RMSE ||
        (unsigned)parameters->metric > (unsigned)EK_METRIC_LINE) {
        return EK_OUT_OF_RANGE;
    }
    if (!isfinite(parameters->epsilon) || parameters->epsilon < EK_R(0.0) ||
        !isfinite(parameters->max_correspondence) || parameters->max_correspondence < EK_R(0.0) ||
        !isfinite(parameters->cauchy) || parameters->cauchy < EK_R(0.0)) {
        return EK_OUT_OF_RANGE;
    }
    return EK_OK;
}

ek_status ek_icp_init(ek_icp *icp, ek_arena *arena, size_t capacity, size_t targets)
{
    if (!icp || !arena) {
        return EK_NULL_POINTER;
    }
    if (capacity == 0u || targets == 0u || capacity > MAX_COUNT || targets > MAX_COUNT) {
        return EK_OUT_OF_RANGE;
    }
    ek_real **const reals[] = {&icp->px, &icp->py, &icp->mx,     &icp->my,       &icp->tx,    &icp->ty,
                               &icp->ax, &icp->ay, &icp->others, &icp->distance, &icp->slack, &icp->weight};
    uint32_t **const numbers[] = {&icp->nearest, &icp->stale, &icp->pair_source, &icp->pair_target};
    memset(icp, 0, sizeof *icp);
    icp->capacity = capacity;
    icp->targets = targets;
    for (size_t i = 0; i < sizeof reals / sizeof *reals; i++) {
        *reals[i] = (ek_real *)ek_arena_alloc(arena, EK_PADDED(capacity), sizeof(ek_real));
    }
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) {
        *numbers[i] = (uint32_t *)ek_arena_alloc(arena, EK_PADDED(capacity), sizeof(uint32_t));
    }
    icp->owner = (uint32_t *)ek_arena_alloc(arena, targets + 1u, sizeof(uint32_t));
    return EK_OK;
}

ek_status ek_icp_init_lines(ek_icp *icp, ek_arena *arena)
{
    if (!icp || !arena) {
        return EK_NULL_POINTER;
    }
    icp->nx = (ek_real *)ek_arena_alloc(arena, EK_PADDED(icp->capacity), sizeof(ek_real));
    icp->ny = (ek_real *)ek_arena_alloc(arena, EK_PADDED(icp->capacity), sizeof(ek_real));
    icp->across = (ek_real *)ek_arena_alloc(arena, EK_PADDED(icp->capacity), sizeof(ek_real));
    return EK_OK;
}

/* Load the source points; the padding repeats the first point and gets weight 0. */
static ek_status load_source(ek_icp *icp, const ek_real *xy, size_t count)
{
    const size_t padded = EK_PADDED(count);
    for (size_t i = 0; i < padded; i++) {
        const size_t from = i < count ? i : 0u;
        icp->px[i] = xy[2u * from];
        icp->py[i] = xy[2u * from + 1u];
        if (!(EK_FABS(icp->px[i]) <= EK_MAX_COORDINATE && EK_FABS(icp->py[i]) <= EK_MAX_COORDINATE)) {
            return isfinite(icp->px[i]) && isfinite(icp->py[i]) ? EK_OUT_OF_RANGE : EK_NOT_FINITE;
        }
        icp->tx[i] = icp->ty[i] = EK_FAR;
        icp->ax[i] = icp->ay[i] = EK_R(0.0);
        icp->others[i] = EK_R(-1.0);
        icp->weight[i] = EK_R(0.0);
        icp->nearest[i] = (uint32_t)icp->targets;
        if (icp->across) {
            icp->nx[i] = icp->ny[i] = EK_R(0.0);
        }
    }
    return EK_OK;
}

/* Move points by a pose; compute distance to the target points and slack. The neighbour of a point cannot have changed
 * while distance + distance moved since the search < lower bound on all other distances at the search. Both sides are
 * squared, which saves a root. All pointers are parameters because compilers vectorise with `restrict` only on
 * parameters. */
static void move_points(size_t padded, ek_pose pose, ek_real limit, ek_real margin, const ek_real *EK_RESTRICT px,
                        const ek_real *EK_RESTRICT py, const ek_real *EK_RESTRICT tx, const ek_real *EK_RESTRICT ty,
                        const ek_real *EK_RESTRICT ax, const ek_real *EK_RESTRICT ay,
                        const ek_real *EK_RESTRICT others, ek_real *EK_RESTRICT mx, ek_real *EK_RESTRICT my,
                        ek_real *EK_RESTRICT distance, ek_real *EK_RESTRICT slack)
{
    const ek_real c = EK_COS(pose.theta), s = EK_SIN(pose.theta), x0 = pose.x, y0 = pose.y;
    for (size_t i = 0; i < padded; i++) {
        const ek_real x = c * px[i] - s * py[i] + x0, y = s * px[i] + c * py[i] + y0;
        const ek_real dx = x - tx[i], dy = y - ty[i], wx = x - ax[i], wy = y - ay[i];
        const ek_real to = EK_SQRT(dx * dx + dy * dy), within = to < limit ? to : limit;
        const ek_real left = others[i] - within - margin, room = left > EK_R(0.0) ? left : EK_R(0.0);
        mx[i] = x;
        my[i] = y;
        distance[i] = to;
        slack[i] = ROUNDED_DOWN * room * room - (wx * wx + wy * wy);
    }
}

static void move_source(ek_icp *icp, size_t padded, ek_pose pose, ek_real limit, ek_real margin)
{
    move_points(padded, pose, limit, margin, icp->px, icp->py, icp->tx, icp->ty, icp->ax, icp->ay, icp->others, icp->mx,
                icp->my, icp->distance, icp->slack);
}

/* Search the neighbour of every point whose neighbour may have changed; returns the number of searches. */
static uint32_t update_neighbours(ek_icp *icp, const ek_index *target, const ek_real *normals, size_t count,
                                  ek_real limit)
{
    uint32_t searches = 0u;
    for (uint32_t i = 0; i < count; i++) {
        icp->stale[searches] = i;
        searches += icp->slack[i] > EK_R(0.0) ? 0u : 1u;
    }
    if (target->table) {
        ek_table_locate(target->table, target, icp->mx, icp->my, icp->stale, searches, icp->pair_source);
    }
    for (uint32_t k = 0; k < searches; k++) {
        const uint32_t i = icp->stale[k];
        const ek_real x = icp->mx[i], y = icp->my[i];
        const ek_real known = icp->distance[i] + BEYOND * target->cells.cell;
        const ek_real radius = icp->distance[i] < limit ? known : FIRST_LOOK * target->cells.cell;
        const ek_neighbour answer = target->table ? ek_table_nearest(target->table, target, icp->pair_source[k], x, y, limit, radius)
                                                  : ek_index_nearest(target, x, y, limit, radius);
        const int found = answer.slot != EK_NONE;
        icp->nearest[i] = found ? answer.slot : (uint32_t)icp->targets;
        icp->tx[i] = found ? target->xy[2u * answer.slot] : EK_FAR;
        icp->ty[i] = found ? target->xy[2u * answer.slot + 1u] : EK_FAR;
        icp->distance[i] = found ? answer.distance : EK_FAR;
        if (found && target->deferred) {
            ek_normals_ensure(target, answer.slot);
        }
        if (normals) {
            icp->nx[i] = found ? normals[2u * target->id[answer.slot]] : EK_R(0.0);
            icp->ny[i] = found ? normals[2u * target->id[answer.slot] + 1u] : EK_R(0.0);
        }
        icp->ax[i] = x;
        icp->ay[i] = y;
        icp->others[i] = answer.others;
    }
    return searches;
}

/* Find, for each target point, the closest of the source points that it is nearest to; of equals the first. The loops
 * have no branch that a processor would have to predict. */
static void find_owners(size_t count, const uint32_t *EK_RESTRICT nearest, const ek_real *EK_RESTRICT distance,
                        uint32_t *EK_RESTRICT owner)
{
    for (uint32_t i = 0; i < count; i++) {
        owner[nearest[i]] = i; /* any of them: entries of earlier passes must not count */
    }
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t rival = owner[nearest[i]];
        const int closer = (distance[i] < distance[rival]) | ((distance[i] == distance[rival]) & (i < rival));
        owner[nearest[i]] = closer ? i : rival;
    }
}

/* Set weight 1 for every pair that is used; returns their number (equation 2). */
static int32_t select_pairs(const ek_icp *icp, size_t count, ek_real limit, int one_to_one)
{
    const ek_real *const EK_RESTRICT distance = icp->distance;
    const uint32_t *const EK_RESTRICT nearest = icp->nearest, *const EK_RESTRICT owner = icp->owner;
    ek_real *const EK_RESTRICT weight = icp->weight;
    int32_t pairs = 0;
    if (one_to_one) {
        find_owners(count, icp->nearest, icp->distance, icp->owner);
    }
    for (uint32_t i = 0; i < count; i++) {
        const int used = (distance[i] < limit) & (!one_to_one | (owner[nearest[i]] == i));
        weight[i] = used ? EK_R(1.0) : EK_R(0.0);
        pairs += used;
    }
    return pairs;
}

/* Distances of the source points to the lines of their pairs. */
static void measure_across(ek_icp *icp, size_t padded)
{
    for (size_t i = 0; i < padded; i++) {
        const ek_real across = (icp->mx[i] - icp->tx[i]) * icp->nx[i] + (icp->my[i] - icp->ty[i]) * icp->ny[i];
        icp->across[i] = EK_FABS(across);
    }
}

/* Error over the pairs (equation 5), in the unit of the stop rule. */
static ek_real compute_error(ek_icp *icp, size_t padded, int32_t pairs, const ek_icp_parameters *parameters)
{
    const ek_error_measure measure = parameters->error;
    const int lines = parameters->metric == EK_METRIC_LINE;
    if (lines) {
        measure_across(icp, padded);
    }
    const ek_real *const distance = lines ? icp->across : icp->distance;
    const ek_real total = ek_fit_sum(icp->weight, distance, padded, measure != EK_ERROR_MEAN) / (ek_real)pairs;
    return measure == EK_ERROR_RMSE ? EK_SQRT(total) : total;
}

/* The step of the pairs at a pose, in the target's frame. */
static ek_pose fit_step(const ek_icp *icp, size_t padded, ek_pose pose, const ek_icp_parameters *parameters)
{
    const ek_pairs pairs = {padded, icp->mx, icp->my, icp->tx, icp->ty, icp->nx, icp->ny, icp->weight};
    return parameters->metric == EK_METRIC_LINE ? ek_fit_lines(&pairs, parameters->cauchy, pose.x, pose.y)
                                                : ek_fit_points(&pairs, pose.x, pose.y);
}

static void call_trace(ek_icp *icp, const ek_index *target, size_t count, ek_icp_iteration *iteration,
                       ek_icp_trace trace, void *context)
{
    size_t pairs = 0;
    for (uint32_t i = 0; i < count; i++) {
        if (icp->weight[i] > EK_R(0.0)) {
            icp->pair_source[pairs] = i;
            icp->pair_target[pairs++] = target->id[icp->nearest[i]];
        }
    }
    iteration->source = icp->pair_source;
    iteration->target = icp->pair_target;
    trace(context, iteration);
}

static ek_status check(const ek_icp *icp, const ek_index *target, const ek_real *source_xy, size_t count,
                       ek_pose guess, const ek_icp_parameters *parameters, const ek_match *match)
{
    if (!icp || !target || !source_xy || !parameters || !match) {
        return EK_NULL_POINTER;
    }
    if (count == 0u) {
        return EK_NO_POINTS;
    }
    if (count > icp->capacity) {
        return EK_TOO_MANY_POINTS;
    }
    if (!ek_se2_is_finite(guess)) {
        return EK_NOT_FINITE;
    }
    if (target->count > icp->targets || EK_FABS(guess.x) > EK_MAX_COORDINATE || EK_FABS(guess.y) > EK_MAX_COORDINATE) {
        return EK_OUT_OF_RANGE;
    }
    const ek_status status = ek_icp_check(parameters);
    if (status == EK_OK && parameters->metric == EK_METRIC_LINE && (!icp->across || (!target->normals && target->count))) {
        return EK_NULL_POINTER;
    }
    return status;
}

static ek_match iterate(ek_icp *icp, const ek_index *target, size_t count, ek_pose guess,
                        const ek_icp_parameters *parameters, ek_icp_trace trace, void *context)
{
    const size_t padded = EK_PADDED(count);
    const int limited = parameters->max_correspondence > EK_R(0.0) && parameters->max_correspondence < MAX_DISTANCE;
    const ek_real limit = limited ? parameters->max_correspondence : MAX_DISTANCE;
    const ek_real *const normals = parameters->metric == EK_METRIC_LINE ? target->normals : NULL;
    ek_match match = {guess, 0, 0, 0, (ek_real)NAN, 0u};
    ek_pose pose = guess;
    ek_real previous = (ek_real)INFINITY;
    if (target->table) {
        ek_table_attach(target->table, target);
    }
    move_source(icp, padded, pose, limit, target->cells.margin);
    EK_COUNT(EK_POINTS, padded);
    while (match.iterations < parameters->max_iterations && !match.converged) {
        EK_COUNT(EK_ITERATIONS, 1u);
        EK_COUNT(EK_POINTS, padded);
        match.queries += update_neighbours(icp, target, normals, count, limit);
        match.inliers = select_pairs(icp, count, limit, parameters->one_to_one);
        if (match.inliers < parameters->min_pairs) {
            match.error = (ek_real)NAN;
            match.target_from_source = guess;
            return match;
        }
        ek_icp_iteration now = {++match.iterations, match.inliers, EK_R(0.0), {EK_R(0.0), EK_R(0.0), EK_R(0.0)},
                                pose, NULL, NULL};
        now.step = fit_step(icp, padded, pose, parameters);
        now.error = parameters->error_before ? compute_error(icp, padded, match.inliers, parameters) : EK_R(0.0);
        pose = ek_se2_compose(now.step, pose); /* equation 9: the step is in the target's frame */
        now.target_from_source = pose;
        move_source(icp, padded, pose, limit, target->cells.margin);
        now.error = parameters->error_before ? now.error : compute_error(icp, padded, match.inliers, parameters);
        if (trace) {
            call_trace(icp, target, count, &now, trace, context);
        }
        match.converged = EK_FABS(now.error - previous) < parameters->epsilon;
        previous = now.error;
    }
    match.target_from_source = pose;
    match.error = parameters->error == EK_ERROR_MEAN_SQUARED ? EK_SQRT(previous) : previous;
    return match;
}

ek_status ek_icp_register(ek_icp *icp, const ek_index *target, const ek_real *source_xy, size_t count, ek_pose guess,
                          const ek_icp_parameters *parameters, ek_icp_trace trace, void *context, ek_match *match)
{
    ek_status status = check(icp, target, source_xy, count, guess, parameters, match);
    status = status == EK_OK ? load_source(icp, source_xy, count) : status;
    if (status == EK_OK) {
        *match = iterate(icp, target, count, guess, parameters, trace, context);
    }
    return status;
}

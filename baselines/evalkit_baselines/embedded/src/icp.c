#include "ek/icp.h"
#include "ek/tally.h"
#include "icp_parts.h"

#include <string.h>

#define MAX_COUNT ((size_t)1 << 30)
#define DENSE 12u /* target points for each source point from which places are searched one by one */
#define MIN_LIMIT EK_R(1e-12) /* m; the square of a smaller limit may be rounded to 0: no candidates are used */
#define PAGE 4096u   /* bytes */
#define SPREAD 320u  /* bytes from the place of a block in its page to that of the next */
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
    parameters.share_noise = 0;
    parameters.origin_x = parameters.origin_y = (ek_real)NAN;
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
        !isfinite(parameters->cauchy) || parameters->cauchy < EK_R(0.0) ||
        EK_FABS(parameters->origin_x) > EK_MAX_COORDINATE || EK_FABS(parameters->origin_y) > EK_MAX_COORDINATE) {
        return EK_OUT_OF_RANGE;
    }
    return EK_OK;
}

/* Allocate an array with an item for each source point. The next one begins at another place of its page: a processor with vectors
 * takes a load for one of what it has just stored elsewhere if both are at the same place of a page. */
static void *allocate(const ek_icp *icp, ek_arena *arena, size_t size)
{
    const size_t count = EK_PADDED(icp->capacity), bytes = count * size;
    const size_t spread = (bytes - SPREAD + PAGE - 1u) / PAGE * PAGE + SPREAD;
    return ek_arena_alloc(arena, EK_GROUPED && bytes >= PAGE ? spread / size : count, size);
}

/* Memory for candidates. */
static void init_candidates(ek_icp *icp, ek_arena *arena)
{
    const size_t candidates = EK_BLOCK * EK_PADDED(icp->capacity);
    icp->cx = (ek_real *)ek_arena_alloc(arena, candidates, sizeof(ek_real));
    icp->cy = (ek_real *)ek_arena_alloc(arena, candidates, sizeof(ek_real));
    icp->slots = (uint32_t *)ek_arena_alloc(arena, candidates, sizeof(uint32_t));
    icp->choice = (ek_real *)allocate(icp, arena, sizeof(ek_real));
}

ek_status ek_icp_init(ek_icp *icp, ek_arena *arena, size_t capacity, size_t targets)
{
    if (!icp || !arena) {
        return EK_NULL_POINTER;
    }
    if (capacity == 0u || targets == 0u || capacity > MAX_COUNT || targets > MAX_COUNT) {
        return EK_OUT_OF_RANGE;
    }
    ek_real **const reals[] = {&icp->mx, &icp->my, &icp->distance, &icp->slack, &icp->weight, &icp->px,
                               &icp->py, &icp->tx, &icp->ty,       &icp->ax,    &icp->ay,     &icp->others};
    uint32_t **const numbers[] = {&icp->nearest, &icp->stale, &icp->pair_source, &icp->pair_target};
    memset(icp, 0, sizeof *icp);
    icp->capacity = capacity;
    icp->targets = targets;
    icp->wide = ek_wide();
    for (size_t i = 0; i < sizeof reals / sizeof *reals; i++) {
        *reals[i] = (ek_real *)allocate(icp, arena, sizeof(ek_real));
    }
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) {
        *numbers[i] = (uint32_t *)allocate(icp, arena, sizeof(uint32_t));
    }
    icp->owner = (uint32_t *)ek_arena_alloc(arena, targets + 1u, sizeof(uint32_t));
    icp->grouped = EK_GROUPED;
    if (EK_GROUPED) {
        init_candidates(icp, arena);
    }
    return EK_OK;
}

ek_status ek_icp_init_lines(ek_icp *icp, ek_arena *arena)
{
    if (!icp || !arena) {
        return EK_NULL_POINTER;
    }
    icp->nx = (ek_real *)allocate(icp, arena, sizeof(ek_real));
    icp->ny = (ek_real *)allocate(icp, arena, sizeof(ek_real));
    icp->across = (ek_real *)allocate(icp, arena, sizeof(ek_real));
    icp->facing = (ek_real *)allocate(icp, arena, sizeof(ek_real));
    icp->share = (ek_real *)allocate(icp, arena, sizeof(ek_real));
    icp->lined = (uint32_t *)allocate(icp, arena, sizeof(uint32_t));
    return EK_OK;
}

ek_status ek_icp_init_table(ek_icp *icp, ek_arena *arena)
{
    if (!icp || !arena) {
        return EK_NULL_POINTER;
    }
    if (!EK_GROUPED) {
        init_candidates(icp, arena);
    }
    return EK_OK;
}

/* Load the source points; the padding repeats the first point, has no neighbour and is not searched for. */
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
        icp->others[i] = i < count ? EK_R(-1.0) : EK_FAR;
        icp->nearest[i] = (uint32_t)icp->targets;
    }
    for (size_t i = 0; i < padded && icp->across; i++) {
        icp->nx[i] = icp->ny[i] = EK_R(0.0);
        icp->facing[i] = EK_R(1.0);
        icp->lined[i] = (uint32_t)icp->targets;
    }
    const size_t abreast = ek_icp_abreast(icp);
    for (size_t k = EK_BLOCK * (padded - EK_LANES); k < EK_BLOCK * padded && icp->choice; k++) {
        /* of the last lanes; those of points are overwritten by the first search */
        icp->cx[k] = icp->cy[k] = ek_icp_far_away(k / abreast % EK_BLOCK);
        icp->slots[k] = 0u;
    }
    return EK_OK;
}

/* As ek_icp_search, with candidates. */
static uint32_t update_candidates(ek_icp *icp, const ek_index *target, const ek_real *normals, size_t count,
                                  ek_real limit, ek_real reach)
{
    const size_t padded = EK_PADDED(count);
    const uint32_t searches = ek_icp_load_candidates(icp, target, padded, limit);
    if (ek_icp_choose(icp, padded, reach, !target->table) > EK_R(0.0)) {
        ek_icp_choose_lowest(icp, target, count);
    }
    ek_icp_take_slots(icp, padded);
    if (normals) {
        ek_icp_take_normals(icp, target, normals, padded);
    }
    return searches;
}

/* The smallest number (m^2) whose root is not below `limit` (m). */
static ek_real square_of_limit(ek_real limit)
{
    const ek_real less = EK_R(1.0) - EK_EPSILON / EK_R(2.0);
    ek_real square = limit * limit; /* the root of a rounded square is the number itself */
    while (EK_SQRT(square * less) >= limit) {
        square *= less;
    }
    return square;
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
    return status == EK_OK && target->table && !icp->choice ? EK_NULL_POINTER : status;
}

static ek_match iterate(ek_icp *icp, const ek_index *target, size_t count, ek_pose guess,
                        const ek_icp_parameters *parameters, ek_icp_trace trace, void *context)
{
    const size_t padded = EK_PADDED(count);
    const int limited = parameters->max_correspondence > EK_R(0.0) && parameters->max_correspondence < MAX_DISTANCE;
    const ek_real limit = limited ? parameters->max_correspondence : MAX_DISTANCE;
    const int grouped = EK_GROUPED && icp->grouped && target->count <= DENSE * count;
    const int candidates = limit >= MIN_LIMIT && (target->table || grouped);
    const ek_real reach = candidates ? square_of_limit(limit) : EK_R(0.0);
    const ek_real *const normals = parameters->metric == EK_METRIC_LINE && target->count ? target->normals : NULL;
    const int sided = normals && target->seen_from && !isnan(parameters->origin_x + parameters->origin_y);
    ek_match match = {guess, 0, 0, 0, (ek_real)NAN, 0u};
    ek_pose pose = guess;
    ek_real previous = (ek_real)INFINITY;
    if (candidates && target->table) {
        ek_table_attach(target->table, target);
    }
    const ek_real origin[2] = {parameters->origin_x, parameters->origin_y};
    ek_real viewer[2];
    ek_se2_transform(guess, origin, 1u, viewer);
    icp->viewer_x = viewer[0];
    icp->viewer_y = viewer[1];
    ek_icp_move(icp, padded, pose, limit, target->cells.margin);
    EK_COUNT(EK_POINTS, padded);
    while (match.iterations < parameters->max_iterations && !match.converged) {
        EK_COUNT(EK_ITERATIONS, 1u);
        EK_COUNT(EK_POINTS, padded);
        if (candidates) {
            match.queries += update_candidates(icp, target, normals, count, limit, reach);
            match.inliers = ek_icp_select_pairs(icp, padded, icp->slack, sided, parameters->one_to_one);
        } else {
            match.queries += ek_icp_search(icp, target, normals, padded, limit);
            ek_icp_weigh_within(icp, padded, limit);
            match.inliers = ek_icp_select_pairs(icp, padded, icp->distance, sided, parameters->one_to_one);
        }
        if (match.inliers < parameters->min_pairs) {
            match.error = (ek_real)NAN;
            match.target_from_source = guess;
            return match;
        }
        ek_icp_iteration now = {++match.iterations, match.inliers, EK_R(0.0), {EK_R(0.0), EK_R(0.0), EK_R(0.0)},
                                pose, NULL, NULL};
        EK_COUNT(EK_FITS, parameters->metric == EK_METRIC_LINE);
        EK_COUNT(EK_FITTED, parameters->metric == EK_METRIC_LINE ? padded : 0u);
        now.step = ek_icp_fit_step(icp, target, padded, pose, parameters);
        if (parameters->error_before) {
            if (candidates) {
                ek_icp_measure_distances(icp, padded);
            }
            now.error = ek_icp_compute_error(icp, padded, match.inliers, parameters);
        }
        pose = ek_se2_compose(now.step, pose); /* equation 9: the step is in the target's frame */
        now.target_from_source = pose;
        ek_icp_move(icp, padded, pose, limit, target->cells.margin);
        now.error = parameters->error_before ? now.error : ek_icp_compute_error(icp, padded, match.inliers, parameters);
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

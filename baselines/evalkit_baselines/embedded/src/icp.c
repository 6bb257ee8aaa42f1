#include "ek/icp.h"
#include "ek/fit.h"
#include "ek/nearby.h"
#include "ek/normals.h"
#include "ek/table.h"
#include "ek/tally.h"
#include "ek/wide.h"
#include "lanes.h"

#include <string.h>

#define MAX_COUNT ((size_t)1 << 30)
#define FIRST_LOOK EK_R(0.75) /* cells: half width of the first search without a known neighbour */
#define BEYOND EK_R(0.25)     /* cells: searched beyond the last neighbour; saves later searches */
#define ALONE EK_R(1.0)       /* cells: searched beyond the limit where no neighbour is within it; likewise */
#define ROUNDED_DOWN (EK_R(1.0) - EK_R(8.0) * EK_EPSILON)
#define ALIKE (EK_R(16.0) * EK_EPSILON) /* share of a square: squares that differ by more have different roots */
#define SHARE EK_R(2.0) /* of the squares around each place that the one around a group may have */
#define ABREAST (32u / sizeof(ek_real)) /* points whose candidates lie side by side: a register of AVX2; EK_LANES with AVX-512 */
#define DENSE 12u /* target points for each source point from which places are searched one by one */
#define AHEAD 32u /* searches from the prefetch of a block to its use */
#define CACHE_LINE 64u
#define MIN_LIMIT EK_R(1e-12) /* m; the square of a smaller limit may be rounded to 0: no candidates are used */
#define MAX_SUPPORT 20u /* points of a mean that count: the points of a scan share the error of its pose */
#define CLEAR_VIEW EK_R(0.1)  /* share across its line of the directions that a target point was seen from: a smaller one is of no side */
#define CLEAR_LOOK EK_R(0.02) /* the same for the direction to where the source points were seen from */
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

/* Memory for candidates. */
static void init_candidates(ek_icp *icp, ek_arena *arena)
{
    const size_t candidates = EK_BLOCK * EK_PADDED(icp->capacity);
    icp->cx = (ek_real *)ek_arena_alloc(arena, candidates, sizeof(ek_real));
    icp->cy = (ek_real *)ek_arena_alloc(arena, candidates, sizeof(ek_real));
    icp->slots = (uint32_t *)ek_arena_alloc(arena, candidates, sizeof(uint32_t));
    icp->choice = (ek_real *)ek_arena_alloc(arena, EK_PADDED(icp->capacity), sizeof(ek_real));
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
    icp->wide = ek_wide();
    for (size_t i = 0; i < sizeof reals / sizeof *reals; i++) {
        *reals[i] = (ek_real *)ek_arena_alloc(arena, EK_PADDED(capacity), sizeof(ek_real));
    }
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) {
        *numbers[i] = (uint32_t *)ek_arena_alloc(arena, EK_PADDED(capacity), sizeof(uint32_t));
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
    icp->nx = (ek_real *)ek_arena_alloc(arena, EK_PADDED(icp->capacity), sizeof(ek_real));
    icp->ny = (ek_real *)ek_arena_alloc(arena, EK_PADDED(icp->capacity), sizeof(ek_real));
    icp->across = (ek_real *)ek_arena_alloc(arena, EK_PADDED(icp->capacity), sizeof(ek_real));
    icp->facing = (ek_real *)ek_arena_alloc(arena, EK_PADDED(icp->capacity), sizeof(ek_real));
    icp->share = (ek_real *)ek_arena_alloc(arena, EK_PADDED(icp->capacity), sizeof(ek_real));
    icp->lined = (uint32_t *)ek_arena_alloc(arena, EK_PADDED(icp->capacity), sizeof(uint32_t));
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

/* Points whose candidates lie side by side: a vector of the processor, where it has one. */
static inline size_t abreast_of(const ek_icp *icp)
{
    return icp->wide == EK_AVX512 ? EK_LANES : ABREAST;
}

/* Coordinate (m) of what stands for candidate k where there is none: two of one point are not equally far. */
static inline ek_real far_away(size_t k)
{
    return EK_FAR * (ek_real)(k + 1u);
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
    const size_t abreast = abreast_of(icp);
    for (size_t k = EK_BLOCK * (padded - EK_LANES); k < EK_BLOCK * padded && icp->choice; k++) {
        icp->cx[k] = icp->cy[k] = far_away(k / abreast % EK_BLOCK); /* of the last lanes; those of points are overwritten by the first search */
        icp->slots[k] = 0u;
    }
    return EK_OK;
}

/* Move points by a pose; compute distance to the target points and slack. The neighbour of a point cannot have changed
 * while distance + distance moved since the search < lower bound on all other distances at the search. Both sides are
 * squared, which saves a root. All pointers are parameters because compilers vectorise with `restrict` only on
 * parameters. */
EK_LOOP void move_points(size_t padded, ek_pose pose, ek_real limit, ek_real margin, const ek_real *EK_RESTRICT px,
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

EK_LOOP void move_of(const ek_icp *p, size_t padded, ek_pose pose, ek_real limit, ek_real margin)
{
    move_points(padded, pose, limit, margin, p->px, p->py, p->tx, p->ty, p->ax, p->ay, p->others, p->mx, p->my,
                p->distance, p->slack);
}

EK_COPIES(void, move_of, (const ek_icp *p, size_t padded, ek_pose pose, ek_real limit, ek_real margin),
          { move_of(p, padded, pose, limit, margin); })

static void move_source(const ek_icp *p, size_t padded, ek_pose pose, ek_real limit, ek_real margin)
{
    EK_CALL(p->wide, move_of, (p, padded, pose, limit, margin));
}

/* Where the first candidate of a point is; the next one is `abreast` further. */
static inline size_t first_candidate(size_t i, size_t abreast)
{
    return EK_BLOCK * (i & ~(abreast - 1u)) + (i & (abreast - 1u));
}

/* Choose the nearest of the candidates of each point, of equals the first, and give it weight 1 if the square of its
 * distance is below `reach` (m^2), else 0. Returns how often two were equally near if `ties` is 1, else 0. */
EK_LOOP ek_real choose_candidates(size_t padded, ek_real reach, int ties, size_t abreast, const ek_real *EK_RESTRICT mx,
                                  const ek_real *EK_RESTRICT my, const ek_real *EK_RESTRICT cx,
                                  const ek_real *EK_RESTRICT cy, ek_real *EK_RESTRICT tx, ek_real *EK_RESTRICT ty,
                                  ek_real *EK_RESTRICT squared, ek_real *EK_RESTRICT choice,
                                  ek_real *EK_RESTRICT weight)
{
    ek_real tied[EK_LANES] = {EK_R(0.0)}, total = EK_R(0.0);
    for (size_t i = 0; i < padded; i += abreast) {
        for (size_t lane = 0; lane < abreast; lane++) {
            const size_t first = EK_BLOCK * i + lane;
            const ek_real x = mx[i + lane], y = my[i + lane];
            ek_real u = cx[first], v = cy[first], best = (x - u) * (x - u) + (y - v) * (y - v), which = EK_R(0.0);
            for (size_t k = 1; k < EK_BLOCK; k++) {
                const ek_real a = cx[first + abreast * k], b = cy[first + abreast * k];
                const ek_real square = (x - a) * (x - a) + (y - b) * (y - b);
                const int closer = square < best;
                if (ties) {
                    tied[lane] += square == best ? EK_R(1.0) : EK_R(0.0);
                }
                u = closer ? a : u;
                v = closer ? b : v;
                which = closer ? (ek_real)k : which;
                best = closer ? square : best;
            }
            tx[i + lane] = u;
            ty[i + lane] = v;
            squared[i + lane] = best;
            choice[i + lane] = which;
            weight[i + lane] = best < reach ? EK_R(1.0) : EK_R(0.0);
        }
    }
    for (size_t lane = 0; lane < EK_LANES; lane++) {
        total += tied[lane];
    }
    return total;
}

/* Constant `ties` and `abreast` only: a loop that tests them is not made into vectors. */
#define CHOOSE(ties, abreast) \
    choose_candidates(padded, reach, ties, abreast, p->mx, p->my, p->cx, p->cy, p->tx, p->ty, p->slack, p->choice, p->weight)

EK_LOOP ek_real choose(const ek_icp *p, size_t padded, ek_real reach)
{
    return CHOOSE(0, ABREAST);
}

EK_LOOP ek_real choose_tied(const ek_icp *p, size_t padded, ek_real reach)
{
    return CHOOSE(1, ABREAST);
}

#if EK_COPIED
EK_WIDE static ek_real choose_avx2(const ek_icp *p, size_t padded, ek_real reach) { return CHOOSE(0, ABREAST); }
EK_WIDE static ek_real choose_tied_avx2(const ek_icp *p, size_t padded, ek_real reach) { return CHOOSE(1, ABREAST); }
EK_WIDEST static ek_real choose_avx512(const ek_icp *p, size_t padded, ek_real reach) { return CHOOSE(0, EK_LANES); }
EK_WIDEST static ek_real choose_tied_avx512(const ek_icp *p, size_t padded, ek_real reach) { return CHOOSE(1, EK_LANES); }
#endif

static ek_real choose_neighbours(const ek_icp *p, size_t padded, ek_real reach, int ties)
{
    return ties ? EK_CALL(p->wide, choose_tied, (p, padded, reach)) : EK_CALL(p->wide, choose, (p, padded, reach));
}

/* Choose of the candidates of a point that are exactly as near as the chosen one that with the lowest index in the cloud. */
static void choose_lowest(const ek_icp *icp, const ek_index *target, size_t count)
{
    const size_t abreast = abreast_of(icp);
    for (size_t i = 0; i < count; i++) {
        const size_t first = first_candidate(i, abreast);
        size_t chosen = (size_t)(int32_t)icp->choice[i];
        for (size_t k = 0; k < EK_BLOCK && icp->weight[i] > EK_R(0.0); k++) {
            const ek_real a = icp->cx[first + abreast * k], b = icp->cy[first + abreast * k];
            const ek_real x = icp->mx[i] - a, y = icp->my[i] - b;
            const uint32_t *const slots = icp->slots + EK_BLOCK * i;
            if (x * x + y * y == icp->slack[i] && target->id[slots[k]] < target->id[slots[chosen]]) {
                chosen = k;
                icp->tx[i] = a;
                icp->ty[i] = b;
            }
        }
        icp->choice[i] = (ek_real)chosen;
    }
}

/* List the points whose neighbour may have changed; returns their number. */
EK_LOOP uint32_t list_lacking(size_t padded, const ek_real *EK_RESTRICT slack, uint32_t *EK_RESTRICT stale)
{
    uint32_t searches = 0u;
    for (uint32_t i = 0; i < padded; i += EK_LANES) {
        for (uint32_t lane = 0; lane < EK_LANES; lane++) {
            stale[searches] = i + lane;
            searches += slack[i + lane] > EK_R(0.0) ? 0u : 1u;
        }
    }
    return searches;
}

#if EK_COPIED
#define list_lacking_avx2 list_lacking
EK_WIDEST static uint32_t list_lacking_avx512(size_t padded, const ek_real *slack, uint32_t *stale)
{
    uint32_t searches = 0u;
    for (uint32_t i = 0; i < padded; i += EK_LANES) {
        const ek_lanes zero = EK_LANES_OF(setzero)(), now = EK_LANES_OF(loadu)(slack + i);
        searches = ek_append_lanes(stale, searches, i, (__mmask8)~EK_BELOW(zero, now));
    }
    return searches;
}
#endif

static uint32_t list_stale(const ek_icp *icp, size_t padded)
{
    return EK_CALL(icp->wide, list_lacking, (padded, icp->slack, icp->stale));
}

/* Take the normal of the target point of a pair, and whether it was seen from the same side: a thin wall has a face on
 * either side. */
static void take_line(ek_icp *icp, const ek_index *target, const ek_real *normals, uint32_t i, uint32_t slot)
{
    const size_t id = target->id[slot];
    const ek_real nx = icp->nx[i] = normals[2u * id], ny = icp->ny[i] = normals[2u * id + 1u];
    if (target->seen_from) {
        const ek_real x = icp->viewer_x - target->xy[2u * slot], y = icp->viewer_y - target->xy[2u * slot + 1u];
        const ek_real from = nx * target->seen_from[2u * id] + ny * target->seen_from[2u * id + 1u], to = nx * x + ny * y;
        const int clear = EK_FABS(from) > CLEAR_VIEW && to * to > CLEAR_LOOK * CLEAR_LOOK * (x * x + y * y);
        icp->facing[i] = clear && (from < EK_R(0.0)) != (to < EK_R(0.0)) ? EK_R(0.0) : EK_R(1.0);
    }
}

/* Half width (m) of the first look for the neighbour of a point. */
static ek_real first_look(const ek_icp *icp, const ek_index *target, uint32_t i, ek_real limit)
{
    const ek_real known = icp->distance[i] + BEYOND * target->cells.cell;
    return icp->distance[i] < limit ? known : FIRST_LOOK * target->cells.cell;
}

/* Search the neighbour of every point whose neighbour may have changed; returns the number of searches. */
static uint32_t update_neighbours(ek_icp *icp, const ek_index *target, const ek_real *normals, size_t padded,
                                  ek_real limit)
{
    const uint32_t searches = list_stale(icp, padded);
    ek_real first = target->cells.cell;
    for (uint32_t k = 0; k < searches; k++) {
        const uint32_t i = icp->stale[k];
        const ek_real look = first_look(icp, target, i, limit);
        const ek_neighbour answer = ek_index_nearest(target, icp->mx[i], icp->my[i], limit, look);
        const int found = answer.slot != EK_NONE;
        icp->tx[i] = found ? target->xy[2u * answer.slot] : EK_FAR;
        icp->ty[i] = found ? target->xy[2u * answer.slot + 1u] : EK_FAR;
        icp->distance[i] = found ? answer.distance : EK_FAR;
        icp->nearest[i] = found ? answer.slot : (uint32_t)icp->targets;
        if (found && normals && target->deferred) {
            ek_normals_ensure(target, answer.slot, &first);
        }
        if (normals) {
            icp->nx[i] = icp->ny[i] = EK_R(0.0);
        }
        if (normals && found) {
            take_line(icp, target, normals, i, answer.slot);
        }
        icp->ax[i] = icp->mx[i];
        icp->ay[i] = icp->my[i];
        icp->others[i] = answer.others;
    }
    return searches;
}

/* Take the points of a block of the table as the candidates of a point. */
static inline void load_block(ek_icp *icp, const ek_block *block, uint32_t i)
{
    const size_t abreast = abreast_of(icp), first = first_candidate(i, abreast);
    ek_real *const EK_RESTRICT x = icp->cx + first, *const EK_RESTRICT y = icp->cy + first;
    for (size_t k = 0; k < EK_BLOCK; k++) {
        x[abreast * k] = block->x[k];
        y[abreast * k] = block->y[k];
    }
    memcpy(icp->slots + EK_BLOCK * i, block->slot, sizeof block->slot);
    icp->ax[i] = block->centre_x;
    icp->ay[i] = block->centre_y;
    icp->others[i] = block->others;
}

/* Take the neighbour that the index finds as the only candidate of a point; `look`: half width (m) of the first look. */
static void load_neighbour(ek_icp *icp, const ek_index *target, uint32_t i, ek_real limit, ek_real look)
{
    const ek_neighbour answer = ek_index_nearest(target, icp->mx[i], icp->my[i], limit, look);
    const int found = answer.slot != EK_NONE;
    ek_block only;
    for (size_t k = 0; k < EK_BLOCK; k++) {
        only.x[k] = found && k == 0u ? target->xy[2u * answer.slot] : far_away(k);
        only.y[k] = found && k == 0u ? target->xy[2u * answer.slot + 1u] : far_away(k);
        only.slot[k] = found && k == 0u ? answer.slot : 0u;
    }
    only.centre_x = icp->mx[i];
    only.centre_y = icp->my[i];
    only.others = answer.others;
    load_block(icp, &only, i);
}

/* Prefetch a block: each of its cache lines, wherever it begins. */
static inline void prefetch_block(const ek_block *block)
{
    const char *const bytes = (const char *)block;
    for (size_t at = 0; at < sizeof *block; at += CACHE_LINE) {
        EK_PREFETCH(bytes + at);
    }
    EK_PREFETCH(bytes + sizeof *block - 1u);
}

/* Load the candidates of the points whose neighbour may have changed; returns the number of searches. */
static uint32_t load_candidates(ek_icp *icp, const ek_index *target, size_t padded, ek_real limit)
{
    ek_table *const table = target->table;
    const uint32_t searches = list_stale(icp, padded);
    ek_table_locate(table, target, icp->mx, icp->my, icp->stale, searches, icp->pair_source);
    for (uint32_t k = 0; k < AHEAD && k < searches; k++) {
        prefetch_block(table->block + icp->pair_source[k]);
    }
    for (uint32_t k = 0; k < searches; k++) {
        const uint32_t i = icp->stale[k], at = icp->pair_source[k];
        prefetch_block(table->block + (k + AHEAD < searches ? icp->pair_source[k + AHEAD] : 0u));
        const ek_block *block = table->block + at;
        if (!block->complete) {
            block = ek_table_block(table, target, at, icp->mx[i], icp->my[i], limit);
        }
        if (block) {
            load_block(icp, block, i);
        } else {
            load_neighbour(icp, target, i, limit, first_look(icp, target, i, limit));
        }
    }
    return searches;
}

/* Take the points that were found for one place of a group as the candidates of a point. */
static inline void load_nearby(ek_icp *icp, const ek_index *target, const ek_nearby *found, uint32_t lane, uint32_t i)
{
    const size_t abreast = abreast_of(icp), first = first_candidate(i, abreast);
    ek_real *const EK_RESTRICT x = icp->cx + first, *const EK_RESTRICT y = icp->cy + first;
    for (size_t k = 0; k < EK_BLOCK; k++) {
        const uint32_t slot = found->slot[lane][k];
        const int none = slot == EK_NONE;
        x[abreast * k] = none ? far_away(k) : target->xy[2u * slot];
        y[abreast * k] = none ? far_away(k) : target->xy[2u * slot + 1u];
        icp->slots[EK_BLOCK * i + k] = none ? 0u : slot;
    }
    icp->ax[i] = icp->mx[i];
    icp->ay[i] = icp->my[i];
    icp->others[i] = found->others[lane];
}

/* Places that are searched together. */
typedef struct {
    uint32_t size;
    ek_real x[EK_GROUP], y[EK_GROUP], radius; /* m */
} group;

/* Gather the first of `count` points and those after it as long as one look for all of them is cheaper than a look for
 * each, by the areas looked at. */
static void gather_group(const ek_icp *icp, const ek_index *target, const uint32_t *points, uint32_t count, ek_real limit,
                         group *places)
{
    const ek_real cell = target->cells.cell;
    ek_real left = EK_FAR, right = -EK_FAR, bottom = EK_FAR, top = -EK_FAR;
    places->radius = EK_R(0.0);
    places->size = 0u;
    for (uint32_t k = 0; k < EK_GROUP && k < count; k++) {
        const ek_real x = icp->mx[points[k]], y = icp->my[points[k]], look = first_look(icp, target, points[k], limit);
        left = x < left ? x : left;
        right = x > right ? x : right;
        bottom = y < bottom ? y : bottom;
        top = y > top ? y : top;
        const ek_real radius = look > places->radius ? look : places->radius, beside = EK_R(2.0) * radius + cell;
        if (k && (right - left + beside) * (top - bottom + beside) > SHARE * (ek_real)(k + 1u) * beside * beside) {
            break;
        }
        places->radius = radius;
        places->x[k] = x;
        places->y[k] = y;
        places->size++;
    }
    for (uint32_t lane = places->size; lane < EK_GROUP; lane++) {
        places->x[lane] = places->x[0];
        places->y[lane] = places->y[0];
    }
}

/* Search for the first of `count` points and those after it that lie beside it; returns how many these are. */
static uint32_t load_group(ek_icp *icp, const ek_index *target, const uint32_t *points, uint32_t count, ek_real limit)
{
    group places;
    ek_nearby found;
    gather_group(icp, target, points, count, limit, &places);
    const int near = ek_index_nearby(target, places.x, places.y, places.radius, icp->wide, &found);
    for (uint32_t lane = 0; lane < places.size; lane++) {
        const uint32_t i = points[lane];
        const int some = near && found.nearest[lane] < limit;
        const ek_real within = some ? found.nearest[lane] : limit;
        if (near && within < found.others[lane]) {
            load_nearby(icp, target, &found, lane, i);
        } else { /* one look that suffices: smaller ones would find what the group has found */
            const ek_real enough = within + (some ? BEYOND : ALONE) * target->cells.cell;
            load_neighbour(icp, target, i, limit, near ? enough : first_look(icp, target, i, limit));
        }
    }
    return places.size;
}

/* As load_candidates, without a table: search the index for groups of points. */
static uint32_t load_groups(ek_icp *icp, const ek_index *target, size_t padded, ek_real limit)
{
    const uint32_t searches = list_stale(icp, padded);
    for (uint32_t done = 0; done < searches;) {
        done += load_group(icp, target, icp->stale + done, searches - done, limit);
    }
    return searches;
}

/* Take the chosen candidate of each point as its neighbour. */
static void take_slots(size_t padded, const uint32_t *EK_RESTRICT slots, const ek_real *EK_RESTRICT choice,
                       uint32_t *EK_RESTRICT nearest)
{
    for (size_t i = 0; i < padded; i += EK_LANES) {
        for (size_t k = i; k < i + EK_LANES; k++) {
            nearest[k] = slots[EK_BLOCK * k + (size_t)(int32_t)choice[k]];
        }
    }
}

/* List the points with weight 1 whose normal is not that of their neighbour; returns their number. */
static uint32_t list_turned(size_t padded, const uint32_t *EK_RESTRICT nearest, const uint32_t *EK_RESTRICT lined,
                            const ek_real *EK_RESTRICT weight, uint32_t *EK_RESTRICT turned)
{
    uint32_t count = 0u;
    for (uint32_t i = 0; i < padded; i += EK_LANES) {
        for (uint32_t k = i; k < i + EK_LANES; k++) {
            turned[count] = k;
            count += (nearest[k] != lined[k]) & (weight[k] > EK_R(0.0));
        }
    }
    return count;
}

/* Take the normals of the neighbours where these have changed. */
static void take_normals(ek_icp *icp, const ek_index *target, const ek_real *normals, size_t padded)
{
    const uint32_t count = list_turned(padded, icp->nearest, icp->lined, icp->weight, icp->stale);
    ek_real first = target->cells.cell;
    for (uint32_t k = 0; k < count; k++) {
        const uint32_t i = icp->stale[k], slot = icp->nearest[i];
        if (target->deferred) {
            ek_normals_ensure(target, slot, &first);
        }
        take_line(icp, target, normals, i, slot);
        icp->lined[i] = slot;
    }
}

/* As update_neighbours, with candidates: from the table of the target, or found in groups. */
static uint32_t update_candidates(ek_icp *icp, const ek_index *target, const ek_real *normals, size_t count,
                                  ek_real limit, ek_real reach)
{
    const size_t padded = EK_PADDED(count);
    const ek_table *const table = target->table;
    const uint32_t searches = EK_GROUPED && !table ? load_groups(icp, target, padded, limit)
                                                   : load_candidates(icp, target, padded, limit);
    if (choose_neighbours(icp, padded, reach, !table) > EK_R(0.0)) {
        choose_lowest(icp, target, count);
    }
    take_slots(padded, icp->slots, icp->choice, icp->nearest);
    if (normals) {
        take_normals(icp, target, normals, padded);
    }
    return searches;
}

/* Give weight 1 to the points that are nearer than `limit` (m), 0 to the others. */
static void weigh_within(size_t padded, ek_real limit, const ek_real *EK_RESTRICT distance,
                          ek_real *EK_RESTRICT weight)
{
    for (size_t i = 0; i < padded; i++) {
        weight[i] = distance[i] < limit ? EK_R(1.0) : EK_R(0.0);
    }
}

/* Set the weights of pairs whose target points were seen from the other side to 0. */
static void keep_facing(size_t padded, const ek_real *EK_RESTRICT facing, ek_real *EK_RESTRICT weight)
{
    for (size_t i = 0; i < padded; i++) {
        weight[i] *= facing[i];
    }
}

/* Whether one distance is smaller, of distances or of their squares: two squares may have the same root. The only branch is
 * one that is hardly ever taken. */
static inline int is_closer(ek_real one, ek_real other, int squared)
{
    if (squared && EK_FABS(other - one) < ALIKE * other) {
        return EK_SQRT(one) < EK_SQRT(other);
    }
    return one < other;
}

/* Of several source points with the same target point, set the weights of all but the closest to 0, of equals of all but
 * the first. `owner` is at first the first source point of each target point; only the later ones, which are few, are
 * compared. No loop has a branch that a processor would have to predict. */
static void keep_closest(size_t padded, const uint32_t *EK_RESTRICT nearest, const ek_real *EK_RESTRICT distance,
                         int squared, uint32_t *EK_RESTRICT owner, uint32_t *EK_RESTRICT later, ek_real *EK_RESTRICT weight)
{
    uint32_t count = 0u;
    for (size_t i = padded; i > 0u; i -= EK_LANES) {
        for (size_t k = 1; k <= EK_LANES; k++) {
            owner[nearest[i - k]] = (uint32_t)(i - k);
        }
    }
    for (uint32_t i = 0; i < padded; i += EK_LANES) {
        for (uint32_t k = i; k < i + EK_LANES; k++) {
            later[count] = k;
            count += owner[nearest[k]] != k;
        }
    }
    for (uint32_t k = 0; k < count; k++) {
        const uint32_t i = later[k], rival = owner[nearest[i]];
        const uint32_t closer = 0u - (uint32_t)is_closer(distance[i], distance[rival], squared), swap = (i ^ rival) & closer;
        owner[nearest[i]] = rival ^ swap;
        weight[i ^ swap] = EK_R(0.0);
    }
}

/* Leave weight 1 to every pair that is used; returns their number (equation 2). Distances or their squares. */
static int32_t select_pairs(const ek_icp *icp, size_t padded, const ek_real *distance, int sided, int one_to_one)
{
    if (sided) {
        keep_facing(padded, icp->facing, icp->weight);
    }
    if (one_to_one) {
        keep_closest(padded, icp->nearest, distance, distance == icp->slack, icp->owner, icp->stale, icp->weight);
    }
    return (int32_t)ek_fit_count(icp->weight, padded, icp->wide);
}

/* Weigh the pairs of each target point: with c source points of variance 1 each and a target point that is the mean of n
 * such points, the sum of their residuals has the variance c + c^2 / n; so each weighs n / (n + c). */
static void share_noise(ek_icp *icp, const ek_index *target, size_t padded)
{
    uint32_t *const pairs = icp->owner;
    for (size_t i = 0; i < padded; i++) {
        pairs[icp->nearest[i]] = 0u;
    }
    for (size_t i = 0; i < padded; i++) {
        pairs[icp->nearest[i]] += icp->weight[i] > EK_R(0.0);
    }
    for (size_t i = 0; i < padded; i++) {
        const uint32_t slot = icp->weight[i] > EK_R(0.0) ? icp->nearest[i] : 0u;
        const uint32_t points = target->support ? target->support[target->id[slot]] : 1u;
        const ek_real independent = (ek_real)(points < MAX_SUPPORT ? points : MAX_SUPPORT);
        icp->share[i] = icp->weight[i] * independent / (independent + (ek_real)pairs[slot]);
    }
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

/* Distances of the source points to the target points of their pairs, from the squares of choose_candidates. */
static void measure_distances(ek_icp *icp, size_t padded)
{
    for (size_t i = 0; i < padded; i++) {
        icp->distance[i] = EK_SQRT(icp->slack[i]);
    }
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
    const ek_real total = ek_fit_sum(icp->weight, distance, padded, measure != EK_ERROR_MEAN, icp->wide) / (ek_real)pairs;
    return measure == EK_ERROR_RMSE ? EK_SQRT(total) : total;
}

/* The step of the pairs at a pose, in the target's frame. */
static ek_pose fit_step(ek_icp *icp, const ek_index *target, size_t padded, ek_pose pose,
                        const ek_icp_parameters *parameters)
{
    const int shared = parameters->share_noise && parameters->metric == EK_METRIC_LINE;
    const ek_pairs pairs = {padded,  icp->mx,     icp->my, icp->tx, icp->ty,
                            icp->nx, icp->ny, icp->weight, shared ? icp->share : NULL, icp->wide};
    if (shared) {
        share_noise(icp, target, padded);
    }
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
    move_source(icp, padded, pose, limit, target->cells.margin);
    EK_COUNT(EK_POINTS, padded);
    while (match.iterations < parameters->max_iterations && !match.converged) {
        EK_COUNT(EK_ITERATIONS, 1u);
        EK_COUNT(EK_POINTS, padded);
        if (candidates) {
            match.queries += update_candidates(icp, target, normals, count, limit, reach);
            match.inliers = select_pairs(icp, padded, icp->slack, sided, parameters->one_to_one);
        } else {
            match.queries += update_neighbours(icp, target, normals, padded, limit);
            weigh_within(padded, limit, icp->distance, icp->weight);
            match.inliers = select_pairs(icp, padded, icp->distance, sided, parameters->one_to_one);
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
        now.step = fit_step(icp, target, padded, pose, parameters);
        if (parameters->error_before) {
            if (candidates) {
                measure_distances(icp, padded);
            }
            now.error = compute_error(icp, padded, match.inliers, parameters);
        }
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

#include "ek/normals.h"
#include "ek/tally.h"
#include "ek/wide.h"
#include "lanes.h"

#include <float.h>
#include <string.h>

#define WIDER EK_R(1.2) /* first search: as wide as the last point's neighbours, and this much wider, */
#define NARROW EK_R(0.25) /* but not narrower than this (cells) */
#define BLOCK 32u      /* points compared at once, at most EK_MAX_NEIGHBOURS */
#define MIN_WALL 3u    /* points within the radius that define a wall */
#define LEAST_SQUARE (sizeof(ek_real) == sizeof(float) ? EK_R(FLT_MIN) : EK_R(DBL_MIN)) /* m^4: smaller ones have lost digits */

/* The nearest points found so far, nearest first. */
typedef struct {
    size_t wanted, count;
    ek_real squared[EK_MAX_NEIGHBOURS]; /* m^2 */
    uint32_t slot[EK_MAX_NEIGHBOURS];
} nearest_points;

/* 1 if a point comes before the k-th nearest found so far. */
static inline int comes_before(const ek_index *index, const nearest_points *found, size_t k, ek_real squared,
                               uint32_t slot)
{
    return squared < found->squared[k] || (squared == found->squared[k] && index->id[slot] < index->id[found->slot[k]]);
}

static inline void insert(const ek_index *index, nearest_points *found, ek_real squared, uint32_t slot)
{
    size_t k = found->count < found->wanted ? found->count++ : found->wanted - 1u;
    EK_COUNT(EK_RANKED, 1u);
    for (; k > 0u && comes_before(index, found, k - 1u, squared, slot); k--) {
        found->squared[k] = found->squared[k - 1u];
        found->slot[k] = found->slot[k - 1u];
        EK_COUNT(EK_RANKED, 1u);
    }
    found->squared[k] = squared;
    found->slot[k] = slot;
}

/* Insert the points of a box that are nearer than `radius` (m); the first test has no branch, because processors cannot
 * predict it. */
static void search_box(const ek_index *index, const ek_cell_box *box, ek_real x, ek_real y, ek_real radius,
                       nearest_points *found)
{
    const ek_real *const xy = index->xy, limit = radius * radius;
    ek_real squared[BLOCK];
    uint32_t slot[BLOCK];
    found->count = 0u;
    for (int32_t row = box->bottom; row <= box->top; row++) {
        const uint32_t *const start = index->start + (size_t)row * index->cells.columns;
        const uint32_t end = start[box->right + 1];
        EK_COUNT(EK_ROWS, 1u);
        EK_COUNT(EK_CANDIDATES, end - start[box->left]);
        for (uint32_t from = start[box->left]; from < end; from += BLOCK) {
            const uint32_t to = end - from < BLOCK ? end : from + BLOCK;
            size_t near = 0u;
            for (uint32_t k = from; k < to; k++) {
                const ek_real dx = xy[2u * k] - x, dy = xy[2u * k + 1u] - y;
                squared[near] = dx * dx + dy * dy;
                slot[near] = k;
                near += squared[near] < limit ? 1u : 0u;
            }
            for (size_t k = 0; k < near; k++) {
                if (found->count < found->wanted ||
                    comes_before(index, found, found->wanted - 1u, squared[k], slot[k])) {
                    insert(index, found, squared[k], slot[k]);
                }
            }
        }
    }
}

/* Points of a box, in no order; there is room for a row of cells and some lanes beyond the last. */
typedef struct {
    uint32_t count;
    ek_real squared[2u * BLOCK + EK_LANES]; /* m^2 */
    uint32_t slot[2u * BLOCK + EK_LANES];
} near_points;

/* Append the points from one slot to another that are nearer than the root of `limit` (m^2). */
static inline void append_row(near_points *near, const ek_real *xy, uint32_t from, uint32_t to, ek_real x, ek_real y,
                              ek_real limit)
{
    uint32_t count = near->count; /* local: kept in a register */
    for (uint32_t k = from; k < to; k++) {
        const ek_real dx = xy[2u * k] - x, dy = xy[2u * k + 1u] - y;
        near->squared[count] = dx * dx + dy * dy;
        near->slot[count] = k;
        count += near->squared[count] < limit ? 1u : 0u;
    }
    near->count = count;
}

#if EK_COPIED
EK_WIDEST static inline void append_row_avx512(near_points *near, const ek_real *xy, uint32_t from, uint32_t to, ek_real x,
                                               ek_real y, ek_real limit)
{
    for (uint32_t k = from; k < to; k += EK_LANES) {
        const uint32_t count = to - k < EK_LANES ? to - k : EK_LANES;
        const ek_lanes squared = ek_square_pairs(xy + 2u * (size_t)k, count, x, y);
        const __mmask8 inside = (__mmask8)(EK_BELOW(squared, EK_LANES_OF(set1)(limit)) & ((1u << count) - 1u));
        EK_LANES_OF(storeu)(near->squared + near->count, EK_LANES_OF(maskz_compress)(inside, squared));
        near->count = ek_append_lanes(near->slot, near->count, k, inside);
    }
}
#else
#define append_row_avx512 append_row
#endif

/* Gather the points of a box that are nearer than `radius` (m); 0 if there are more than BLOCK. `widest`: constant. */
EK_LOOP int gather_near(const ek_index *index, const ek_cell_box *box, ek_real x, ek_real y, ek_real radius, int widest,
                        near_points *near)
{
    const ek_real limit = radius * radius;
    near->count = 0u;
    for (int32_t row = box->bottom; row <= box->top; row++) {
        const uint32_t *const start = index->start + (size_t)row * index->cells.columns;
        const uint32_t from = start[box->left], to = start[box->right + 1];
        if (to - from > BLOCK) {
            return 0;
        }
        (widest ? append_row_avx512 : append_row)(near, index->xy, from, to, x, y, limit);
        if (near->count > BLOCK) {
            return 0;
        }
    }
    return 1;
}

EK_LOOP int gather_box(const ek_index *index, const ek_cell_box *box, ek_real x, ek_real y, ek_real radius,
                       near_points *near)
{
    return gather_near(index, box, x, y, radius, 0, near);
}

#if EK_COPIED
#define gather_box_avx2 gather_box
EK_WIDEST static int gather_box_avx512(const ek_index *index, const ek_cell_box *box, ek_real x, ek_real y, ek_real radius,
                                       near_points *near)
{
    return gather_near(index, box, x, y, radius, 1, near);
}
#endif

/* Count for each point how many others are nearer. */
EK_LOOP void rank_points(size_t count, ek_real *EK_RESTRICT squared, ek_real *EK_RESTRICT rank)
{
    for (size_t k = count; k < EK_PADDED(count); k++) {
        squared[k] = EK_R(0.0);
    }
    for (size_t i = 0; i < count; i += EK_LANES) {
        ek_real nearer[EK_LANES] = {EK_R(0.0)};
        for (size_t k = 0; k < count; k++) {
            for (size_t lane = 0; lane < EK_LANES; lane++) {
                nearer[lane] += squared[k] < squared[i + lane] ? EK_R(1.0) : EK_R(0.0);
            }
        }
        memcpy(rank + i, nearer, sizeof nearer);
    }
}

#if EK_COPIED
EK_WIDE static void rank_points_avx2(size_t count, ek_real *squared, ek_real *rank) { rank_points(count, squared, rank); }

/* The bits of one comparison with all points are counted: no sum waits for another one. */
EK_WIDEST static void rank_points_avx512(size_t count, ek_real *squared, ek_real *rank)
{
    ek_lanes all[BLOCK / EK_LANES];
    for (size_t k = count; k < BLOCK; k++) {
        squared[k] = EK_FAR * EK_FAR; /* nearer than no point */
    }
    for (size_t group = 0; group < BLOCK / EK_LANES; group++) {
        all[group] = EK_LANES_OF(loadu)(squared + EK_LANES * group);
    }
    for (size_t k = 0; k < count; k++) {
        const ek_lanes one = EK_LANES_OF(set1)(squared[k]);
        const __mmask16 low = _mm512_kunpackb(EK_BELOW(all[1], one), EK_BELOW(all[0], one));
        const __mmask16 high = _mm512_kunpackb(EK_BELOW(all[3], one), EK_BELOW(all[2], one));
        rank[k] = (ek_real)__builtin_popcount((uint32_t)high << 16 | low);
    }
}
#endif

/* As search_box, by ranks, which no processor has to predict; where fewer than `least` points are near, only their number.
 * 0 if more than BLOCK points are near, or two equally near ones. */
static int rank_box(const ek_index *index, const ek_cell_box *box, ek_real x, ek_real y, ek_real radius, size_t least,
                    nearest_points *found)
{
    near_points near;
    ek_real rank[BLOCK], sum = EK_R(0.0);
    if (!EK_CALL(index->wide, gather_box, (index, box, x, y, radius, &near))) {
        return 0;
    }
    found->count = near.count < found->wanted ? near.count : found->wanted;
    if (near.count < least) {
        return 1;
    }
    EK_CALL(index->wide, rank_points, (near.count, near.squared, rank));
    for (size_t k = 0; k < near.count; k++) {
        const size_t at = (size_t)(int32_t)rank[k];
        found->squared[at] = near.squared[k];
        found->slot[at] = near.slot[k];
        sum += rank[k];
    }
    return !(EK_R(2.0) * sum < (ek_real)near.count * ((ek_real)near.count - EK_R(1.0)));
}

/* Find the nearest points of (x, y) within `limit` (m); returns the distance (m) of the farthest of them. */
static ek_real find_nearest(const ek_index *index, ek_real x, ek_real y, ek_real radius, ek_real limit,
                            nearest_points *found)
{
    for (;;) {
        const int widest = radius - index->cells.margin >= limit;
        const ek_cell_box box = ek_cell_grid_box(&index->cells, x, y, radius);
        const int last = ek_cell_grid_is_all(&index->cells, &box) || widest;
        const ek_real within = last ? limit : radius - index->cells.margin;
        const size_t least = last ? 0u : found->wanted;
        if (!(EK_IF_WIDE(index->wide) && rank_box(index, &box, x, y, within, least, found))) {
            search_box(index, &box, x, y, within, found);
        }
        if (found->count == found->wanted || last) {
            return found->count > 0u ? EK_SQRT(found->squared[found->count - 1u]) : EK_R(0.0);
        }
        radius *= EK_R(2.0);
    }
}

/* As how many points a point counts in a line. */
static inline ek_real weight_of(const ek_index *index, uint32_t slot)
{
    return index->noisy ? ek_index_support(index, slot) : EK_R(1.0);
}

/* Normal of the line through the points found, from their covariance about their mean. */
static void normal_of(const ek_index *index, const nearest_points *found, ek_real x, ek_real y, ek_real normal[2])
{
    const ek_real *const xy = index->xy;
    ek_real count = EK_R(0.0), mean_x = EK_R(0.0), mean_y = EK_R(0.0), difference = EK_R(0.0), product = EK_R(0.0);
    EK_COUNT(EK_NORMALS, 1u);
    EK_COUNT(EK_RANKED, found->count);
    for (size_t k = 0; k < found->count; k++) {
        const ek_real weight = weight_of(index, found->slot[k]);
        count += weight;
        mean_x += weight * (xy[2u * found->slot[k]] - x);
        mean_y += weight * (xy[2u * found->slot[k] + 1u] - y);
    }
    mean_x /= count;
    mean_y /= count;
    for (size_t k = 0; k < found->count; k++) {
        const ek_real u = xy[2u * found->slot[k]] - x - mean_x, v = xy[2u * found->slot[k] + 1u] - y - mean_y;
        const ek_real weight = weight_of(index, found->slot[k]);
        difference += weight * (u - v) * (u + v);
        product += weight * EK_R(2.0) * u * v;
    }
    /* cosine and sine of twice the line's angle, which lies in (-90, 90] degrees */
    const ek_real square = difference * difference + product * product;
    const ek_real length = square >= LEAST_SQUARE ? EK_SQRT(square) : EK_R(0.0); /* else the points coincide */
    const ek_real cosine = length > EK_R(0.0) ? difference / length : EK_R(1.0);
    const ek_real sine = length > EK_R(0.0) ? product / length : EK_R(0.0);
    if (cosine >= EK_R(0.0)) {
        normal[1] = EK_SQRT(EK_R(0.5) * (EK_R(1.0) + cosine));
        normal[0] = EK_R(-0.5) * sine / normal[1];
    } else {
        const ek_real across = EK_SQRT(EK_R(0.5) * (EK_R(1.0) - cosine));
        normal[0] = sine < EK_R(0.0) ? across : -across;
        normal[1] = EK_R(0.5) * EK_FABS(sine) / across;
    }
}

/* Compute the normal of the point in a slot. *first: half width of the first search (m); afterwards that for a point beside
 * this one. */
static void compute_one(const ek_index *index, uint32_t slot, ek_real *first, ek_real radius, nearest_points *found,
                        ek_real *normal)
{
    const ek_real x = index->xy[2u * slot], y = index->xy[2u * slot + 1u], cell = index->cells.cell;
    const ek_real farthest = find_nearest(index, x, y, *first, radius, found);
    const ek_real widest = cell * (EK_R(1.0) + (ek_real)found->wanted / EK_R(3.0)); /* 3 points per cell */
    *first = WIDER * farthest < widest ? WIDER * farthest : widest;
    *first = *first > NARROW * cell ? *first : NARROW * cell;
    if (radius < EK_FAR && (found->count < MIN_WALL || !(farthest > EK_R(0.0)))) {
        normal[0] = normal[1] = EK_R(0.0);
    } else {
        normal_of(index, found, x, y, normal);
    }
}

ek_status ek_normals_compute(const ek_index *index, size_t neighbours, ek_real radius, ek_real *normals)
{
    nearest_points found;
    if (!index || (!normals && index->count)) {
        return EK_NULL_POINTER;
    }
    if (neighbours < 2u || neighbours > EK_MAX_NEIGHBOURS || !(radius > EK_R(0.0))) {
        return EK_OUT_OF_RANGE;
    }
    found.wanted = neighbours < index->count ? neighbours : index->count;
    ek_real first = index->cells.cell;
    for (uint32_t k = 0; k < index->count; k++) {
        compute_one(index, k, &first, radius, &found, normals + 2u * index->id[k]);
    }
    return EK_OK;
}

ek_status ek_normals_defer(ek_index *index, size_t neighbours, ek_real *normals)
{
    if (!index || (!normals && index->count)) {
        return EK_NULL_POINTER;
    }
    if (neighbours < 2u || neighbours > EK_MAX_NEIGHBOURS) {
        return EK_OUT_OF_RANGE;
    }
    if (index->count) {
        memset(normals, 0, 2u * index->count * sizeof *normals);
    }
    index->normals = index->deferred = normals;
    index->neighbours = (uint32_t)neighbours;
    return EK_OK;
}

void ek_normals_ensure(const ek_index *index, uint32_t slot, ek_real *first)
{
    ek_real *const normal = index->deferred + 2u * (size_t)index->id[slot];
    nearest_points found;
    if (EK_FABS(normal[0]) + EK_FABS(normal[1]) > EK_R(0.0)) {
        return;
    }
    found.wanted = index->neighbours < index->count ? index->neighbours : index->count;
    compute_one(index, slot, first, EK_FAR, &found, normal);
}

#include "ek/index.h"
#include "ek/tally.h"
#include "ek/wide.h"
#include "lanes.h"

#include <string.h>

#define MAX_COUNT ((size_t)1 << 30)

ek_status ek_index_init(ek_index *index, ek_arena *arena, size_t capacity, size_t cells)
{
    if (!index || !arena) {
        return EK_NULL_POINTER;
    }
    if (capacity == 0u || cells == 0u || capacity > MAX_COUNT || cells > MAX_COUNT) {
        return EK_OUT_OF_RANGE;
    }
    memset(index, 0, sizeof *index);
    index->capacity = capacity;
    index->cell_capacity = cells;
    index->wide = ek_wide();
    index->xy = (ek_real *)ek_arena_alloc(arena, 2u * EK_INDEX_SLOTS(capacity), sizeof(ek_real));
    index->id = (uint32_t *)ek_arena_alloc(arena, EK_INDEX_SLOTS(capacity), sizeof(uint32_t));
    index->start = (uint32_t *)ek_arena_alloc(arena, cells + 2u + EK_INDEX_BLOCK, sizeof(uint32_t));
    index->scratch = (uint32_t *)ek_arena_alloc(arena, EK_INDEX_SLOTS(capacity), sizeof(uint32_t));
    if (arena->memory && ek_arena_check(arena) == EK_OK) {
        memset(index->start, 0, (cells + 2u + EK_INDEX_BLOCK) * sizeof(uint32_t));
    }
    return EK_OK;
}

/* Squared distances (m^2) of the best and the second best candidate. */
typedef struct {
    ek_real best, second;
    uint32_t slot;
} candidates;

/* Compare the points in slots [from, to). */
static inline void compare_slots(const ek_index *index, uint32_t from, uint32_t to, ek_real x, ek_real y,
                                 candidates *found)
{
    const ek_real *const EK_RESTRICT xy = index->xy;
    ek_real best = found->best, second = found->second;
    uint32_t slot = found->slot;
    EK_COUNT(EK_ROWS, 1u);
    EK_COUNT(EK_CANDIDATES, to - from);
    for (uint32_t k = from; k < to; k++) {
        const ek_real dx = xy[2u * k] - x, dy = xy[2u * k + 1u] - y, squared = dx * dx + dy * dy;
        const ek_real worse = squared > best ? squared : best;
        second = worse < second ? worse : second;
        slot = squared < best ? k : slot;
        best = squared < best ? squared : best;
    }
    found->best = best;
    found->second = second;
    found->slot = slot;
}

/* Find the slot with the lowest cloud index among those exactly as near as the best. */
static uint32_t find_lowest_id(const ek_index *index, const ek_cell_box *box, ek_real x, ek_real y, ek_real best)
{
    uint32_t slot = EK_NONE;
    for (int32_t row = box->bottom; row <= box->top; row++) {
        const uint32_t base = (uint32_t)row * index->cells.columns;
        const uint32_t from = index->start[base + (uint32_t)box->left];
        const uint32_t to = index->start[base + (uint32_t)box->right + 1u];
        EK_COUNT(EK_ROWS, 1u);
        EK_COUNT(EK_CANDIDATES, to - from);
        for (uint32_t k = from; k < to; k++) {
            const ek_real dx = index->xy[2u * k] - x, dy = index->xy[2u * k + 1u] - y;
            if (dx * dx + dy * dy <= best && (slot == EK_NONE || index->id[k] < index->id[slot])) {
                slot = k;
            }
        }
    }
    return slot;
}

/* Compare the points in the cells of a box. */
EK_LOOP void compare_box(const ek_index *index, const ek_cell_box *box, ek_real x, ek_real y, candidates *found)
{
    found->best = found->second = EK_FAR * EK_FAR;
    found->slot = EK_NONE;
    const uint32_t *start = index->start + (size_t)box->bottom * index->cells.columns;
    for (int32_t line = box->bottom; line <= box->top; line++, start += index->cells.columns) {
        compare_slots(index, start[box->left], start[box->right + 1], x, y, found);
    }
}

#if EK_COPIED
#define compare_box_avx2 compare_box

/* Eight points of a row at a time; most rows have no more. Of equally near points another one may be taken: then the one with
 * the lowest index in the cloud is looked for. */
EK_WIDEST static void compare_box_avx512(const ek_index *index, const ek_cell_box *box, ek_real x, ek_real y,
                                         candidates *found)
{
    const ek_lanes far_off = EK_LANES_OF(set1)(EK_FAR * EK_FAR);
    ek_lanes best = far_off, second = far_off;
    __m256i slots = _mm256_set1_epi32((int32_t)EK_NONE);
    const uint32_t *start = index->start + (size_t)box->bottom * index->cells.columns;
    for (int32_t line = box->bottom; line <= box->top; line++, start += index->cells.columns) {
        const uint32_t to = start[box->right + 1];
        for (uint32_t k = start[box->left]; k < to; k += EK_LANES) {
            const uint32_t count = to - k < EK_LANES ? to - k : EK_LANES;
            const ek_lanes squares = ek_square_pairs(index->xy + 2u * (size_t)k, count, x, y);
            const ek_lanes squared = EK_LANES_OF(mask_mov)(far_off, (__mmask8)((1u << count) - 1u), squares);
            const __mmask8 nearer = EK_BELOW(squared, best);
            second = EK_LANES_OF(min)(second, EK_LANES_OF(max)(squared, best));
            best = EK_LANES_OF(min)(squared, best); /* the second one where a number is nan */
            slots = _mm256_mask_mov_epi32(slots, nearer, ek_count_lanes(k));
        }
    }
    found->best = ek_least_lane(best);
    const uint32_t lane = (uint32_t)__builtin_ctz((uint32_t)EK_EQUAL(best, EK_LANES_OF(set1)(found->best)));
    found->second = ek_least_lane(EK_LANES_OF(min)(second, EK_LANES_OF(mask_mov)(best, (__mmask8)(1u << lane), far_off)));
    found->slot = (uint32_t)_mm256_cvtsi256_si32(_mm256_permutevar8x32_epi32(slots, _mm256_set1_epi32((int32_t)lane)));
}
#endif

/* Search all cells that a square of half width `radius` (m) around (x, y) touches; fill *box with them. Returns a lower
 * bound on the distance (m) to any point outside them, reduced by `margin` for rounding. */
static inline ek_real search_square(const ek_index *index, ek_real x, ek_real y, ek_real radius, ek_real margin,
                                    ek_cell_box *box, candidates *found)
{
    const ek_cell_grid *const frame = &index->cells;
    *box = ek_cell_grid_box(frame, x, y, radius);
    EK_CALL(index->wide, compare_box, (index, box, x, y, found));
    return ek_cell_grid_is_all(frame, box) ? EK_FAR : radius - margin;
}

/* Distance (m) of a place to the cells, along x or y, whichever is larger: no point is nearer; 0 inside. */
static inline ek_real distance_to_cells(const ek_cell_grid *cells, ek_real x, ek_real y)
{
    const ek_real right = cells->left + (ek_real)cells->columns * cells->cell;
    const ek_real top = cells->bottom + (ek_real)cells->rows * cells->cell;
    const ek_real across = cells->left - x > x - right ? cells->left - x : x - right;
    const ek_real up = cells->bottom - y > y - top ? cells->bottom - y : y - top, farther = across > up ? across : up;
    return farther > EK_R(0.0) ? farther : EK_R(0.0);
}

ek_neighbour ek_index_nearest(const ek_index *index, ek_real x, ek_real y, ek_real limit, ek_real radius)
{
    ek_neighbour answer = {EK_NONE, EK_FAR, EK_FAR};
    if (index->count == 0u) {
        return answer;
    }
    candidates found;
    ek_cell_box box;
    EK_COUNT(EK_SEARCHES, 1u);
    /* far from the points rounding errors are larger; without this term the search would not end */
    const ek_real margin = index->cells.margin + EK_R(16.0) * EK_EPSILON * (EK_FABS(x) + EK_FABS(y));
    ek_real border = search_square(index, x, y, radius, margin, &box, &found), best = EK_SQRT(found.best);
    if (border <= best && border < limit) {
        const ek_real outside = distance_to_cells(&index->cells, x, y);
        if (outside - margin >= limit) {
            answer.others = outside - margin;
            return answer;
        }
        radius = radius > outside ? radius : EK_R(0.5) * outside + radius; /* the next look reaches the cells */
    }
    while (border <= best && border < limit) {
        const ek_real needed = (best < limit ? best : limit) + EK_R(4.0) * margin;
        radius = needed < EK_R(2.0) * radius ? needed : EK_R(2.0) * radius;
        border = search_square(index, x, y, radius, margin, &box, &found);
        best = EK_SQRT(found.best);
    }
    const ek_real second = EK_SQRT(found.second);
    if (best < limit) {
        answer.slot = found.second > found.best ? found.slot : find_lowest_id(index, &box, x, y, found.best);
        answer.distance = best;
        answer.others = second < border ? second : border;
    } else {
        answer.others = best < border ? best : border;
    }
    return answer;
}

#include "ek/nearby.h"
#include "ek/wide.h"
#include "lanes.h"

#include <string.h>

#define BITS 8 /* of a key for the number of a candidate; the 23 bits above are its squared distance */
#define MAX_AROUND (1u << BITS)
#define LARGEST 8387584.0f /* 2^23 - 1024: no rounding reaches 2^23 */
#define ROUNDING EK_R(2e-6) /* error of a distance in single precision, as a share of the largest one */
#define NO_KEY INT32_MAX

/* Candidates of all places, relative to the first place (m). */
typedef struct {
    uint32_t count, slot[MAX_AROUND + EK_LANES];
    float x[MAX_AROUND + EK_LANES], y[MAX_AROUND + EK_LANES];
    ek_cell_box box; /* cells that contain them */
} surroundings;

/* Keep the EK_BLOCK + 1 smallest keys of each place, in ascending order. */
EK_LOOP void rank(uint32_t count, float scale, const float *EK_RESTRICT cx, const float *EK_RESTRICT cy,
                  const float *EK_RESTRICT px, const float *EK_RESTRICT py, int32_t (*EK_RESTRICT ranked)[EK_GROUP])
{
    int32_t keys[EK_BLOCK + 1u][EK_GROUP]; /* local: kept in registers */
    for (uint32_t j = 0; j <= EK_BLOCK; j++) {
        for (uint32_t lane = 0; lane < EK_GROUP; lane++) {
            keys[j][lane] = NO_KEY;
        }
    }
    for (uint32_t k = 0; k < count; k++) {
        const float x = cx[k], y = cy[k];
        EK_LANE_BY_LANE
        for (uint32_t lane = 0; lane < EK_GROUP; lane++) {
            const float dx = x - px[lane], dy = y - py[lane];
            int32_t key = (int32_t)((dx * dx + dy * dy) * scale) * (int32_t)MAX_AROUND + (int32_t)k;
            for (uint32_t j = 0; j <= EK_BLOCK; j++) {
                const int32_t old = keys[j][lane], now = key;
                keys[j][lane] = now < old ? now : old;
                key = now < old ? old : now;
            }
        }
    }
    for (uint32_t j = 0; j <= EK_BLOCK; j++) {
        for (uint32_t lane = 0; lane < EK_GROUP; lane++) {
            ranked[j][lane] = keys[j][lane];
        }
    }
}

#if EK_COPIED
EK_WIDE static void rank_avx2(uint32_t count, float scale, const float *cx, const float *cy, const float *px,
                              const float *py, int32_t (*ranked)[EK_GROUP])
{
    rank(count, scale, cx, cy, px, py, ranked);
}

/* Insert keys into those of the same lanes, which are in ascending order. */
EK_WIDEST static inline void insert_keys(__m512i keys[EK_BLOCK + 1u], __m512i key)
{
    for (uint32_t j = 0; j <= EK_BLOCK; j++) {
        const __m512i old = keys[j];
        keys[j] = _mm512_min_epi32(key, old);
        key = _mm512_max_epi32(key, old);
    }
}

/* As rank, with two candidates at once: the eight places in the lower half of a register with one, in the upper half with the
 * other. No two keys are equal, so that the smallest ones do not depend on the order. */
EK_WIDEST static void rank_avx512(uint32_t count, float scale, const float *cx, const float *cy, const float *px,
                                  const float *py, int32_t (*ranked)[EK_GROUP])
{
    const __m512i none = _mm512_set1_epi32(NO_KEY);
    const __m512 place_x = _mm512_broadcast_f32x8(_mm256_loadu_ps(px)), place_y = _mm512_broadcast_f32x8(_mm256_loadu_ps(py));
    __m512i keys[EK_BLOCK + 1u];
    for (uint32_t j = 0; j <= EK_BLOCK; j++) {
        keys[j] = none;
    }
    for (uint32_t k = 0; k < count; k += 2u) {
        const uint32_t next = k + 1u < count ? k + 1u : k;
        const __m512 x = _mm512_mask_blend_ps(0xFF00u, _mm512_set1_ps(cx[k]), _mm512_set1_ps(cx[next]));
        const __m512 y = _mm512_mask_blend_ps(0xFF00u, _mm512_set1_ps(cy[k]), _mm512_set1_ps(cy[next]));
        const __m512 dx = _mm512_sub_ps(x, place_x), dy = _mm512_sub_ps(y, place_y);
        const __m512 squared = _mm512_add_ps(_mm512_mul_ps(dx, dx), _mm512_mul_ps(dy, dy));
        const __m512i numbers = _mm512_mask_set1_epi32(_mm512_set1_epi32((int32_t)k), 0xFF00u, (int32_t)next);
        const __m512i large = _mm512_slli_epi32(_mm512_cvttps_epi32(_mm512_mul_ps(squared, _mm512_set1_ps(scale))), BITS);
        const __m512i key = _mm512_add_epi32(large, numbers);
        insert_keys(keys, next > k ? key : _mm512_mask_blend_epi32(0xFF00u, key, none));
    }
    __m512i all[EK_BLOCK + 1u];
    memcpy(all, keys, sizeof all);
    for (uint32_t j = 0; j <= EK_BLOCK; j++) {
        insert_keys(all, _mm512_shuffle_i64x2(keys[j], keys[j], 0x4E));
    }
    for (uint32_t j = 0; j <= EK_BLOCK; j++) {
        _mm256_storeu_si256((__m256i *)(void *)ranked[j], _mm512_castsi512_si256(all[j]));
    }
}
#endif

/* Append `points` points from the slot `from` on, relative to (x, y). */
static inline void append_row(surroundings *around, const ek_real *xy, uint32_t from, uint32_t points, ek_real x, ek_real y)
{
    uint32_t count = around->count; /* local: kept in a register */
    for (uint32_t k = 0; k < points; k++) {
        around->slot[count] = from + k;
        around->x[count] = (float)(xy[2u * k] - x);
        around->y[count++] = (float)(xy[2u * k + 1u] - y);
    }
    around->count = count;
}

#if EK_COPIED
/* The same, eight points at a time: most rows have no more, and need no branch. */
EK_WIDEST static inline void append_row_avx512(surroundings *around, const ek_real *xy, uint32_t from, uint32_t points,
                                               ek_real x, ek_real y)
{
    for (uint32_t k = 0; k < points; k += EK_LANES) {
        ek_lanes xs, ys;
        ek_split_pairs(xy + 2u * k, points - k < EK_LANES ? points - k : EK_LANES, &xs, &ys);
        _mm256_storeu_ps(around->x + around->count + k, ek_single_lanes(EK_LANES_OF(sub)(xs, EK_LANES_OF(set1)(x))));
        _mm256_storeu_ps(around->y + around->count + k, ek_single_lanes(EK_LANES_OF(sub)(ys, EK_LANES_OF(set1)(y))));
        ek_store_numbers(around->slot + around->count + k, ek_count_lanes(from + k));
    }
    around->count += points;
}
#else
#define append_row_avx512 append_row
#endif

/* Gather the points of the box, relative to (x, y); 0 if there are too many. `widest`: constant. */
EK_LOOP int gather_box(const ek_index *index, ek_real x, ek_real y, int widest, surroundings *around)
{
    const ek_cell_box box = around->box;
    around->count = 0u;
    for (int32_t row = box.bottom; row <= box.top; row++) {
        const uint32_t *const start = index->start + (size_t)row * index->cells.columns;
        const uint32_t from = start[box.left], points = start[box.right + 1] - from;
        if (points > MAX_AROUND - around->count) {
            return 0;
        }
        (widest ? append_row_avx512 : append_row)(around, index->xy + 2u * (size_t)from, from, points, x, y);
    }
    return 1;
}

EK_LOOP int gather_points(const ek_index *index, ek_real x, ek_real y, surroundings *around)
{
    return gather_box(index, x, y, 0, around);
}

#if EK_COPIED
#define gather_points_avx2 gather_points
EK_WIDEST static int gather_points_avx512(const ek_index *index, ek_real x, ek_real y, surroundings *around)
{
    return gather_box(index, x, y, 1, around);
}
#endif

/* Gather the points in the cells that squares around the places touch, relative to (x, y); 0 if there are too many. */
static int gather(const ek_index *index, const ek_bounds *places, ek_real radius, ek_real x, ek_real y, int wide,
                  surroundings *around)
{
    const ek_cell_grid *const grid = &index->cells;
    const int32_t last_column = (int32_t)grid->columns - 1, last_row = (int32_t)grid->rows - 1;
    ek_cell_box *const box = &around->box;
    box->left = ek_cell_grid_clamp((places->left - radius - grid->left) * grid->per_cell, last_column);
    box->right = ek_cell_grid_clamp((places->right + radius - grid->left) * grid->per_cell, last_column);
    box->bottom = ek_cell_grid_clamp((places->bottom - radius - grid->bottom) * grid->per_cell, last_row);
    box->top = ek_cell_grid_clamp((places->top + radius - grid->bottom) * grid->per_cell, last_row);
    return EK_CALL(wide, gather_points, (index, x, y, around));
}

/* Edges of the cells of a box (m). */
static ek_bounds find_edges(const ek_cell_grid *grid, const ek_cell_box *box)
{
    const ek_bounds edges = {grid->left + (ek_real)box->left * grid->cell,
                             grid->left + (ek_real)(box->right + 1) * grid->cell,
                             grid->bottom + (ek_real)box->bottom * grid->cell,
                             grid->bottom + (ek_real)(box->top + 1) * grid->cell};
    return edges;
}

/* What bounds the distances of places to their candidates and to all other points. */
typedef struct {
    ek_bounds open;   /* edges behind which there are cells; far away where there are none (m) */
    ek_real margin;   /* rounding of a distance to an edge (m) */
    ek_real rounding; /* of a distance in single precision (m) */
    float per;        /* m^2 of a key without its number */
} limits;

/* Bounds on the distances of each place, and the slots of its candidates. */
EK_LOOP void finish(const limits *known, const uint32_t *EK_RESTRICT slots, const ek_real *EK_RESTRICT x,
                    const ek_real *EK_RESTRICT y, const int32_t (*EK_RESTRICT ranked)[EK_GROUP],
                    ek_nearby *EK_RESTRICT found)
{
    const ek_bounds open = known->open;
    const ek_real margin = known->margin, rounding = known->rounding;
    const float per = known->per;
    EK_LANE_BY_LANE
    for (uint32_t lane = 0; lane < EK_GROUP; lane++) {
        const int32_t first = ranked[0][lane] >> BITS, next = ranked[EK_BLOCK][lane];
        const ek_real left = x[lane] - open.left, right = open.right - x[lane], bottom = y[lane] - open.bottom,
                      top = open.top - y[lane];
        const ek_real across = left < right ? left : right, up = bottom < top ? bottom : top;
        const ek_real far_off = EK_R(16.0) * EK_EPSILON * (EK_FABS(x[lane]) + EK_FABS(y[lane]));
        const ek_real border = (across < up ? across : up) - (margin + far_off);
        const ek_real rest = (ek_real)sqrtf((float)(next >> BITS) * per) - rounding;
        const ek_real least = next == NO_KEY ? EK_FAR : rest;
        found->nearest[lane] = (ek_real)sqrtf((float)(first + 1) * per) + rounding;
        found->others[lane] = least < border ? least : border;
    }
    for (uint32_t j = 0; j < EK_BLOCK; j++) {
        EK_LANE_BY_LANE
        for (uint32_t lane = 0; lane < EK_GROUP; lane++) {
            const uint32_t key = (uint32_t)ranked[j][lane], at = slots[key % MAX_AROUND];
            found->slot[j][lane] = key == (uint32_t)NO_KEY ? EK_NONE : at;
        }
    }
}

EK_COPIES(void, finish,
          (const limits *known, const uint32_t *slots, const ek_real *x, const ek_real *y, const int32_t (*ranked)[EK_GROUP],
           ek_nearby *found),
          { finish(known, slots, x, y, ranked, found); })

int ek_index_nearby(const ek_index *index, const ek_real x[EK_GROUP], const ek_real y[EK_GROUP], ek_real radius, int wide,
                    ek_nearby *found)
{
    ek_bounds places = {x[0], x[0], y[0], y[0]};
    float px[EK_GROUP], py[EK_GROUP];
    int32_t keys[EK_BLOCK + 1u][EK_GROUP];
    surroundings around;
    for (uint32_t lane = 0; lane < EK_GROUP; lane++) {
        places.left = x[lane] < places.left ? x[lane] : places.left;
        places.right = x[lane] > places.right ? x[lane] : places.right;
        places.bottom = y[lane] < places.bottom ? y[lane] : places.bottom;
        places.top = y[lane] > places.top ? y[lane] : places.top;
        px[lane] = (float)(x[lane] - x[0]);
        py[lane] = (float)(y[lane] - y[0]);
    }
    if (index->count == 0u || !gather(index, &places, radius, x[0], y[0], wide, &around)) {
        return 0;
    }
    /* no place is farther from a candidate */
    const ek_bounds edges = find_edges(&index->cells, &around.box);
    const ek_real across = (edges.right > places.right ? edges.right : places.right) -
                           (edges.left < places.left ? edges.left : places.left);
    const ek_real up = (edges.top > places.top ? edges.top : places.top) -
                       (edges.bottom < places.bottom ? edges.bottom : places.bottom);
    if (!(across + up > EK_R(0.0))) {
        return 0; /* far away, cells are smaller than the distance between two numbers */
    }
    const float scale = LARGEST / (float)((across + up) * (across + up));
    const ek_cell_box *const box = &around.box;
    const limits known = {{box->left > 0 ? edges.left : -EK_FAR,
                           box->right + 1 < (int32_t)index->cells.columns ? edges.right : EK_FAR,
                           box->bottom > 0 ? edges.bottom : -EK_FAR,
                           box->top + 1 < (int32_t)index->cells.rows ? edges.top : EK_FAR},
                          index->cells.margin, ROUNDING * (across + up) + index->cells.margin, 1.0f / scale};
    EK_CALL(wide, rank, (around.count, scale, around.x, around.y, px, py, keys));
    EK_CALL(wide, finish, (&known, around.slot, x, y, (const int32_t(*)[EK_GROUP])keys, found));
    return 1;
}

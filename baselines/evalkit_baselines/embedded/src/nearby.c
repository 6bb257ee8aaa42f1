#include "ek/nearby.h"
#include "ek/wide.h"
#include "lanes.h"

#include <string.h>

#define MAX_AROUND 256u
#define NUMBER ((int32_t)MAX_AROUND - 1) /* bits of a key */
#define NO_KEY (227 << 23)        /* bits of 2^100 in single precision; keys from it on are of no candidate */
#define NOWHERE 0x1p60f           /* m: where there is no candidate */
#define KEPT 8u                   /* keys of a place; EK_BLOCK + 1 are needed */
#define BATCH 4u                  /* keys of a place that are added at once */
#define ROUNDING EK_R(2e-6)       /* error of a distance in single precision, as a share of the largest one */
#define UNDERFLOW_ERROR EK_R(2e-19) /* m, likewise: of one whose square is too small for single precision */

/* Candidates of all places, relative to the first place (m). */
typedef struct {
    uint32_t count, slot[MAX_AROUND + EK_LANES];
    float x[MAX_AROUND + EK_LANES], y[MAX_AROUND + EK_LANES];
    ek_cell_box box; /* cells that contain them */
} surroundings;

/* The key of a candidate at (dx, dy) from a place: the bits of its squared distance in single precision, of which the last hold its
 * number. Keys are ordered as these squares are, and none is equal to another. */
static inline int32_t make_key(float dx, float dy, uint32_t number)
{
    const float squared = dx * dx + dy * dy;
    int32_t bits;
    memcpy(&bits, &squared, sizeof bits);
    return (bits & ~NUMBER) | (int32_t)number;
}

/* The square (m^2) with these bits. */
static inline float square_of(int32_t bits)
{
    float square;
    memcpy(&square, &bits, sizeof square);
    return square;
}

/* Put the smaller of two keys first. */
static inline void order(int32_t *first, int32_t *second)
{
    const int32_t one = *first, other = *second;
    *first = one < other ? one : other;
    *second = one < other ? other : one;
}

static inline void sort_batch(int32_t key[BATCH])
{
    order(&key[0], &key[1]);
    order(&key[2], &key[3]);
    order(&key[0], &key[2]);
    order(&key[1], &key[3]);
    order(&key[1], &key[2]);
}

/* Keep the smallest of the keys and of a batch, both in ascending order (Batcher 1968, bitonic sorter). */
static inline void merge_batch(int32_t key[KEPT], int32_t batch[BATCH])
{
    for (uint32_t j = 0; j < BATCH; j++) {
        order(&key[KEPT - 1u - j], &batch[j]);
    }
    for (uint32_t j = 0; j < 4u; j++) {
        order(&key[j], &key[j + 4u]);
    }
    for (uint32_t j = 0; j < KEPT; j += 4u) {
        order(&key[j], &key[j + 2u]);
        order(&key[j + 1u], &key[j + 3u]);
    }
    for (uint32_t j = 0; j < KEPT; j += 2u) {
        order(&key[j], &key[j + 1u]);
    }
}

/* Keep the smallest keys of each place, in ascending order. Candidates after the last one are nowhere. */
EK_LOOP void rank(uint32_t count, const float *EK_RESTRICT cx, const float *EK_RESTRICT cy, const float *EK_RESTRICT px,
                  const float *EK_RESTRICT py, int32_t (*EK_RESTRICT ranked)[EK_GROUP])
{
    int32_t keys[KEPT][EK_GROUP]; /* local: kept in registers */
    for (uint32_t j = 0; j < KEPT; j++) {
        for (uint32_t lane = 0; lane < EK_GROUP; lane++) {
            keys[j][lane] = NO_KEY;
        }
    }
    for (uint32_t k = 0; k < count; k += BATCH) {
        EK_LANE_BY_LANE
        for (uint32_t lane = 0; lane < EK_GROUP; lane++) {
            int32_t key[KEPT], batch[BATCH];
            for (uint32_t j = 0; j < BATCH; j++) {
                batch[j] = make_key(cx[k + j] - px[lane], cy[k + j] - py[lane], k + j);
            }
            for (uint32_t j = 0; j < KEPT; j++) {
                key[j] = keys[j][lane];
            }
            sort_batch(batch);
            merge_batch(key, batch);
            for (uint32_t j = 0; j < KEPT; j++) {
                keys[j][lane] = key[j];
            }
        }
    }
    memcpy(ranked, keys, sizeof keys);
}

EK_COPIES(void, rank,
          (uint32_t count, const float *cx, const float *cy, const float *px, const float *py, int32_t (*ranked)[EK_GROUP]),
          { rank(count, cx, cy, px, py, ranked); })

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
    if (!EK_CALL(wide, gather_points, (index, x, y, around))) {
        return 0;
    }
    for (uint32_t k = around->count; k < around->count + EK_LANES; k++) {
        around->x[k] = around->y[k] = NOWHERE;
    }
    return 1;
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
} limits;

/* Bounds on the distances of each place, and the slots of its candidates. */
EK_LOOP void finish(const limits *known, const uint32_t *EK_RESTRICT slots, const ek_real *EK_RESTRICT x,
                    const ek_real *EK_RESTRICT y, const int32_t (*EK_RESTRICT ranked)[EK_GROUP],
                    ek_nearby *EK_RESTRICT found)
{
    const ek_bounds open = known->open;
    const ek_real margin = known->margin, rounding = known->rounding;
    EK_LANE_BY_LANE
    for (uint32_t lane = 0; lane < EK_GROUP; lane++) {
        /* the largest square that the first key can stand for, and the least one that the last can */
        const float first = square_of(ranked[0][lane] | NUMBER), next = square_of(ranked[EK_BLOCK][lane] & ~NUMBER);
        const ek_real left = x[lane] - open.left, right = open.right - x[lane], bottom = y[lane] - open.bottom,
                      top = open.top - y[lane];
        const ek_real across = left < right ? left : right, up = bottom < top ? bottom : top;
        const ek_real far_off = EK_R(16.0) * EK_EPSILON * (EK_FABS(x[lane]) + EK_FABS(y[lane]));
        const ek_real border = (across < up ? across : up) - (margin + far_off);
        const ek_real least = (ek_real)sqrtf(next) - rounding; /* far away where there is no such point */
        found->nearest[lane] = (ek_real)sqrtf(first) + rounding;
        found->others[lane] = least < border ? least : border;
    }
    for (uint32_t j = 0; j < EK_BLOCK; j++) {
        EK_LANE_BY_LANE
        for (uint32_t lane = 0; lane < EK_GROUP; lane++) {
            const uint32_t key = (uint32_t)ranked[j][lane], at = slots[key % MAX_AROUND];
            found->slot[j][lane] = key >= (uint32_t)NO_KEY ? EK_NONE : at;
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
    int32_t keys[KEPT][EK_GROUP];
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
    const ek_cell_box *const box = &around.box;
    const limits known = {{box->left > 0 ? edges.left : -EK_FAR,
                           box->right + 1 < (int32_t)index->cells.columns ? edges.right : EK_FAR,
                           box->bottom > 0 ? edges.bottom : -EK_FAR,
                           box->top + 1 < (int32_t)index->cells.rows ? edges.top : EK_FAR},
                          index->cells.margin, ROUNDING * (across + up) + UNDERFLOW_ERROR + index->cells.margin};
    EK_CALL(wide, rank, (around.count, around.x, around.y, px, py, keys));
    EK_CALL(wide, finish, (&known, around.slot, x, y, (const int32_t(*)[EK_GROUP])keys, found));
    return 1;
}

#include "ek/search.h"
#include "ek/tally.h"

#include <string.h>

#define MAX_POINTS ((size_t)1 << 20)
#define FAR_CELLS EK_R(1073741824.0) /* whole numbers of 32 bits hold sums of two such */
#define TURN_WORK 8u /* operations for a point at each angle */
#define MILD EK_R(0.02)
#define ROUNDING EK_R(1e-9)

#ifdef EK_FLOAT
#define ASIN asinf
#define CEIL ceilf
#else
#define ASIN asin
#define CEIL ceil
#endif

ek_status ek_search_init(ek_search *search, ek_arena *arena, size_t capacity)
{
    if (!search || !arena) {
        return EK_NULL_POINTER;
    }
    if (capacity == 0u || capacity > MAX_POINTS) {
        return EK_OUT_OF_RANGE;
    }
    memset(search, 0, sizeof *search);
    search->capacity = capacity;
    search->column = (int32_t *)ek_arena_alloc(arena, capacity, sizeof(int32_t));
    search->row = (int32_t *)ek_arena_alloc(arena, capacity, sizeof(int32_t));
    return EK_OK;
}

/* Angles one step apart, which moves the farthest point by one cell. */
static void fit_angles(ek_search *search)
{
    const ek_real turn = EK_R(2.0) * EK_PI, cell = search->grid->cell;
    ek_real reach = cell;
    for (size_t i = 0; i < search->count; i++) {
        const ek_real x = search->xy[2u * i], y = search->xy[2u * i + 1u], range = EK_SQRT(x * x + y * y);
        reach = range > reach ? range : reach;
    }
    const ek_real half = EK_R(0.5) * cell / reach; /* at most a half */
    search->step = EK_R(2.0) * ASIN(half);
    if (search->window.theta < EK_PI) {
        const uint32_t count = (uint32_t)(search->window.theta / search->step + ROUNDING);
        search->angles = 2u * count + 1u;
        search->lowest = -(int32_t)count;
    } else {
        search->angles = (uint32_t)CEIL(turn / search->step);
        search->lowest = -(int32_t)(search->angles / 2u);
        search->step = turn / (ek_real)search->angles;
    }
}

static int32_t half_cells(ek_real length, ek_real cell)
{
    const ek_real cells = length / cell + ROUNDING;
    return cells < (ek_real)EK_SEARCH_MAX_HALF ? (int32_t)cells : EK_SEARCH_MAX_HALF;
}

ek_status ek_search_begin(ek_search *search, const ek_score_grid *grid, const ek_real *xy, size_t count,
                          const ek_search_window *window, const ek_search_prior *prior, ek_real min_score)
{
    if (!search || !grid || !xy || !window || !prior) {
        return EK_NULL_POINTER;
    }
    if (count == 0u || count > search->capacity) {
        return count ? EK_TOO_MANY_POINTS : EK_NO_POINTS;
    }
    search->grid = grid;
    search->xy = xy;
    search->count = count;
    search->window = *window;
    search->prior = *prior;
    search->half_x = half_cells(window->x, grid->cell);
    search->half_y = half_cells(window->y, grid->cell);
    search->first_level = 0u;
    for (int32_t most = search->half_x > search->half_y ? search->half_x : search->half_y; most; most >>= 1) {
        search->first_level += search->first_level + 1u < EK_SCORE_LEVELS;
    }
    search->angle = 0u;
    search->waiting = 0u;
    search->found = 0;
    search->score = min_score;
    search->left_out = EK_R(0.0);
    search->evaluated = 0u;
    fit_angles(search);
    return EK_OK;
}

/* Number of the angle that is `k`-th from the middle: 0, 1, -1, 2, -2 ... as far as there are such. */
static int32_t angle_number(const ek_search *search, uint32_t k)
{
    const int32_t highest = search->lowest + (int32_t)search->angles - 1;
    const int32_t both = highest < -search->lowest ? highest : -search->lowest;
    if (k > 2u * (uint32_t)both) {
        return -(int32_t)(k - (uint32_t)both); /* one more angle on the lower side */
    }
    return k % 2u ? (int32_t)(k + 1u) / 2 : -(int32_t)(k / 2u);
}

static int32_t to_cell(ek_real cells)
{
    return (int32_t)(cells < -FAR_CELLS ? -FAR_CELLS : cells > FAR_CELLS ? FAR_CELLS : EK_FLOOR(cells));
}

/* Cells of the points at an angle, with the translation of the centre. */
static void turn_points(ek_search *search)
{
    const ek_real theta = search->window.centre.theta + search->offset, c = EK_COS(theta), s = EK_SIN(theta);
    const ek_real x0 = search->window.centre.x - search->grid->left, y0 = search->window.centre.y - search->grid->bottom;
    const ek_real cell = search->grid->cell;
    for (size_t i = 0; i < search->count; i++) {
        const ek_real x = search->xy[2u * i], y = search->xy[2u * i + 1u];
        search->column[i] = to_cell((c * x - s * y + x0) / cell);
        search->row[i] = to_cell((s * x + c * y + y0) / cell);
    }
}

static int32_t clamp(int32_t at, int32_t last)
{
    const int32_t within = at > 0 ? at : 0;
    return within < last ? within : last;
}

/* Distance (cells) from the centre to the nearest motion of a block. */
static ek_real nearest_offset(int32_t low, uint32_t level)
{
    const int32_t high = low + (int32_t)(1u << level) - 1;
    return (ek_real)(low > 0 ? low : high < 0 ? -high : 0);
}

/* Upper bound on the score of the motions of a block; at level 0 the score of a motion. */
static ek_real bound_of(ek_search *search, int32_t x, int32_t y, uint32_t level)
{
    const ek_score_grid *const grid = search->grid;
    const uint8_t *const scores = grid->level[level];
    const int32_t *const EK_RESTRICT column = search->column, *const EK_RESTRICT row = search->row;
    const int32_t last_column = grid->columns - 1, last_row = grid->rows - 1;
    uint32_t sum = 0u;
    for (size_t i = 0; i < search->count; i++) {
        const int32_t at = clamp(row[i] + y, last_row) * grid->columns + clamp(column[i] + x, last_column);
        sum += scores[at];
    }
    EK_COUNT(EK_LOOKUPS, search->count);
    search->evaluated++;
    const ek_real score = (ek_real)sum / (ek_real)(EK_SCORE_FULL * search->count);
    if (!(search->prior.theta > EK_R(0.0))) {
        return score;
    }
    const ek_real u = nearest_offset(x, level) * grid->cell / search->prior.x;
    const ek_real v = nearest_offset(y, level) * grid->cell / search->prior.y;
    const ek_real t = search->offset / search->prior.theta;
    return score * (EK_R(1.0) / (EK_R(1.0) + MILD * (u * u + v * v + t * t)));
}

/* Put a block on the stack if it may hold a better motion; above `from` the stack stays sorted, the best on top. */
static void push(ek_search *search, size_t from, int32_t x, int32_t y, uint32_t level)
{
    const ek_search_block block = {x, y, level, bound_of(search, x, y, level)};
    if (!(block.bound > search->score)) {
        search->left_out = block.bound > search->left_out ? block.bound : search->left_out;
        return;
    }
    size_t at = search->waiting++;
    for (; at > from && search->stack[at - 1u].bound >= block.bound; at--) {
        search->stack[at] = search->stack[at - 1u];
    }
    search->stack[at] = block;
}

static void begin_angle(ek_search *search, ek_work *work)
{
    const int32_t side = (int32_t)1 << search->first_level;
    uint64_t blocks = 0u;
    search->offset = (ek_real)angle_number(search, search->angle++) * search->step;
    turn_points(search);
    for (int32_t x = -search->half_x; x <= search->half_x; x += side) {
        for (int32_t y = -search->half_y; y <= search->half_y; y += side, blocks++) {
            push(search, 0u, x, y, search->first_level);
        }
    }
    ek_work_spend(work, TURN_WORK * search->count);
    ek_work_spend_tallied(work, blocks * search->count);
}

static void expand(ek_search *search, ek_work *work)
{
    const ek_search_block block = search->stack[--search->waiting];
    if (!(block.bound > search->score)) {
        return;
    }
    if (block.level == 0u) {
        search->found = 1;
        search->score = block.bound;
        search->best.x = search->window.centre.x + (ek_real)block.x * search->grid->cell;
        search->best.y = search->window.centre.y + (ek_real)block.y * search->grid->cell;
        search->best.theta = ek_se2_wrap(search->window.centre.theta + search->offset);
        return;
    }
    const int32_t side = (int32_t)1 << (block.level - 1u);
    const size_t from = search->waiting;
    uint64_t blocks = 0u;
    for (int32_t x = block.x; x <= block.x + side && x <= search->half_x; x += side) {
        for (int32_t y = block.y; y <= block.y + side && y <= search->half_y; y += side, blocks++) {
            push(search, from, x, y, block.level - 1u);
        }
    }
    ek_work_spend_tallied(work, blocks * search->count);
}

int ek_search_work(ek_search *search, ek_work *work)
{
    while (work->left > 0) {
        if (search->waiting) {
            expand(search, work);
        } else if (search->angle < search->angles) {
            begin_angle(search, work);
        } else {
            return 1;
        }
    }
    return !search->waiting && search->angle == search->angles;
}

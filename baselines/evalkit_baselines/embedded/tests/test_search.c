/* Thinning, the score grid and branch and bound, each against a plain computation. */
#include "src/search.c"

#include "check.h"

#define CAPACITY 512u
#define CELLS ((size_t)192 * 192)
#define CELL 0.1

static ek_thinner thinner;
static ek_score_grid grid;
static ek_search search;
static ek_real target[2u * CAPACITY], source[2u * CAPACITY], means[2u * CAPACITY];
static ek_work work;

static void means_of_cells_are_those_of_a_hand_calculation(void)
{
    /* cells of 1 m: (-1, 0) has two points, (0, -2) and (0, 0) one each; ordered by x, then y */
    const ek_real xy[] = {EK_R(0.5), EK_R(0.25), EK_R(-0.5), EK_R(0.5), EK_R(0.75), EK_R(-1.5), EK_R(-0.25), EK_R(0.0)};
    CHECK(ek_thin(&thinner, xy, 4u, EK_R(1.0), means, &work) == 3u);
    CHECK_NEAR(means[0], -0.375, TOLERANCE);
    CHECK_NEAR(means[1], 0.25, TOLERANCE);
    CHECK_NEAR(means[3], -1.5, TOLERANCE);
    CHECK_NEAR(means[5], 0.25, TOLERANCE);
    CHECK(ek_thin(&thinner, xy, 0u, EK_R(1.0), means, &work) == 0u);
}

static void cells_are_found_wherever_they_lie(uint64_t *seed)
{
    for (size_t i = 0; i < CAPACITY; i++) { /* far apart: all digits of the keys are sorted */
        target[2u * i] = uniform(seed, -9e5, 9e5);
        target[2u * i + 1u] = uniform(seed, -9e5, 9e5);
    }
    const size_t cells = ek_thin(&thinner, target, CAPACITY, EK_R(0.05), means, &work);
    CHECK(cells > CAPACITY - 20u);
    ek_work spent = ek_work_make(INT64_MAX);
    ek_thin(&thinner, target, CAPACITY, EK_R(0.05), means, &spent);
    CHECK(spent.done == 8u * CAPACITY);
    for (size_t k = 1; k < cells; k++) {
        CHECK(EK_FLOOR(means[2u * k] / EK_R(0.05)) >= EK_FLOOR(means[2u * k - 2u] / EK_R(0.05)));
    }
}

/* Scores of cells: 255 where a point is at the centre; exp(-1 / 2) of it a cell farther; maxima over squares. */
static void scores_and_their_maxima_are_those_of_a_hand_calculation(void)
{
    const ek_real xy[] = {EK_R(1.05), EK_R(2.05)};
    ek_score_grid_draw(&grid, &thinner, xy, 1u, EK_R(CELL), EK_R(0.0), EK_R(0.0), means, &work);
    const int32_t column = (int32_t)EK_FLOOR((xy[0] - grid.left) / grid.cell),
                  row = (int32_t)EK_FLOOR((xy[1] - grid.bottom) / grid.cell);
    ek_work drawn = ek_work_make(INT64_MAX), raised = ek_work_make(INT64_MAX);
    ek_score_grid_draw(&grid, &thinner, xy, 1u, EK_R(CELL), EK_R(0.0), EK_R(0.0), means, &drawn);
    ek_score_grid_raise(&grid, 1u, &raised);
    const uint64_t cells = (uint64_t)grid.columns * (uint64_t)grid.rows;
    CHECK(drawn.done > cells / 16u + 8u && drawn.done <= cells / 16u + 100u && raised.done == cells / 8u);
    const uint8_t *const at = grid.level[0] + (size_t)row * (size_t)grid.columns + column;
    CHECK(at[0] == 255u && at[1] == 155u && at[-1] == 155u && at[grid.columns] == 155u); /* 255 exp(-1/2) = 154.7 */
    CHECK(at[grid.columns + 1] == 94u && at[3] == 3u && at[4] == 0u);                     /* 93.8, 2.8 */
    for (uint32_t level = 1; level < EK_SCORE_LEVELS; level++) {
        ek_score_grid_raise(&grid, level, &work);
    }
    for (uint32_t level = 1; level < EK_SCORE_LEVELS; level++) {
        const int32_t side = (int32_t)1 << level;
        for (int32_t y = 0; y < grid.rows; y += 3) {
            for (int32_t x = 0; x < grid.columns; x += 3) {
                uint8_t most = 0u;
                for (int32_t v = y; v < y + side && v < grid.rows; v++) {
                    for (int32_t u = x; u < x + side && u < grid.columns; u++) {
                        const uint8_t score = grid.level[0][v * grid.columns + u];
                        most = score > most ? score : most;
                    }
                }
                CHECK(grid.level[level][y * grid.columns + x] == most);
            }
        }
    }
}

/* Walls of a room with a pillar, seen from a pose. */
static size_t room(ek_real *xy, ek_pose from, uint64_t *seed)
{
    size_t count = 0u;
    for (int k = 0; k < 60; k++) {
        const double along = 0.1 * k;
        const ek_pose points[] = {{EK_R(along), EK_R(0.0), EK_R(0.0)},        {EK_R(0.0), EK_R(0.7 * along), EK_R(0.0)},
                                  {EK_R(along), EK_R(4.2), EK_R(0.0)},        {EK_R(6.0), EK_R(0.7 * along), EK_R(0.0)},
                                  {EK_R(2.0 + 0.01 * k), EK_R(1.5), EK_R(0.0)}};
        for (size_t i = 0; i < 5u; i++, count++) {
            const ek_pose seen = ek_se2_between(from, points[i]);
            xy[2u * count] = seen.x + uniform(seed, -0.02, 0.02);
            xy[2u * count + 1u] = seen.y + uniform(seed, -0.02, 0.02);
        }
    }
    return count;
}

/* The best score of all motions of the lattice. */
static ek_real exhaustive(const ek_search *of)
{
    ek_real best = EK_R(0.0);
    for (uint32_t a = 0; a < of->angles; a++) {
        const ek_real offset = (ek_real)(of->lowest + (int32_t)a) * of->step, theta = of->window.centre.theta + offset;
        const ek_real c = EK_COS(theta), s = EK_SIN(theta);
        for (int32_t x = -of->half_x; x <= of->half_x; x++) {
            for (int32_t y = -of->half_y; y <= of->half_y; y++) {
                uint32_t sum = 0u;
                for (size_t i = 0; i < of->count; i++) {
                    const ek_real u = of->xy[2u * i], v = of->xy[2u * i + 1u];
                    const ek_real px = c * u - s * v + (of->window.centre.x - grid.left);
                    const ek_real py = s * u + c * v + (of->window.centre.y - grid.bottom);
                    const int32_t column = (int32_t)EK_FLOOR(px / grid.cell) + x, row = (int32_t)EK_FLOOR(py / grid.cell) + y;
                    const int inside = column >= 0 && row >= 0 && column < grid.columns && row < grid.rows;
                    sum += inside ? grid.level[0][row * grid.columns + column] : 0u;
                }
                const ek_real u = (ek_real)x * grid.cell, v = (ek_real)y * grid.cell;
                const ek_real squares = of->prior.theta > EK_R(0.0)
                                            ? u * u / (of->prior.x * of->prior.x) + v * v / (of->prior.y * of->prior.y) +
                                                  offset * offset / (of->prior.theta * of->prior.theta)
                                            : EK_R(0.0);
                const ek_real score = (ek_real)sum / (ek_real)(EK_SCORE_FULL * of->count) / (EK_R(1.0) + EK_R(0.02) * squares);
                best = score > best ? score : best;
            }
        }
    }
    return best;
}

static void the_best_score_is_that_of_an_exhaustive_search(uint64_t *seed)
{
    static const ek_search_prior priors[] = {{EK_R(0.2), EK_R(0.3), EK_R(0.1)}, {EK_R(0.0), EK_R(0.0), EK_R(0.0)}};
    const ek_pose origin = {EK_R(0.0), EK_R(0.0), EK_R(0.0)}, there = {EK_R(2.5), EK_R(1.9), EK_R(0.4)};
    size_t count = room(target, origin, seed);
    ek_score_grid_draw(&grid, &thinner, target, count, EK_R(CELL), EK_R(2.0), EK_R(2.0), means, &work);
    for (uint32_t level = 1; level < EK_SCORE_LEVELS; level++) {
        ek_score_grid_raise(&grid, level, &work);
    }
    count = room(source, there, seed);
    for (int k = 0; k < 8; k++) {
        ek_search_window window = {there, EK_R(0.65), EK_R(0.35), k == 7 ? EK_PI : EK_R(0.1)};
        window.x = k % 3 == 1 ? EK_R(0.45) : window.x;
        window.centre.x += uniform(seed, -0.4, 0.4);
        window.centre.y += uniform(seed, -0.3, 0.3);
        CHECK(ek_search_begin(&search, &grid, source, k == 7 ? 40u : 120u, &window, priors + k % 2, EK_R(0.1)) == EK_OK);
        for (int done = 0; !done;) {
            ek_work little = ek_work_make(500);
            done = ek_search_work(&search, &little);
            CHECK(little.done <= 500u + 72u * search.count);
        }
        CHECK(search.found);
        CHECK_NEAR(search.score, exhaustive(&search), TOLERANCE);
        CHECK(k >= 6 || EK_FABS(ek_se2_between(search.best, there).theta) < EK_R(0.06));
        const ek_real best = search.score;
        ek_work all = ek_work_make(INT64_MAX);
        for (int step = 0; step < 2; step++) { /* the bound is tight where the least score is the best one */
            const ek_real least = best + EK_R(0.2 * step);
            CHECK(ek_search_begin(&search, &grid, source, search.count, &window, priors + k % 2, least) == EK_OK);
            CHECK(ek_search_work(&search, &all) && !search.found);
            CHECK(search.left_out >= best && search.left_out <= least);
        }
    }
    const ek_search_window far = {{EK_R(100.0), EK_R(0.0), EK_R(0.0)}, EK_R(0.5), EK_R(0.5), EK_R(0.1)};
    ek_work all = ek_work_make(INT64_MAX);
    CHECK(ek_search_begin(&search, &grid, source, count, &far, priors, EK_R(0.1)) == EK_OK);
    CHECK(ek_search_work(&search, &all) && !search.found && !(search.left_out > EK_R(0.0)));
}

/* Angles from the middle to both sides, one more on the lower side of an even number; the nearest motion of a block; cells
 * cut at the border and at what 32 bits hold. */
static void parts_of_a_search_are_those_of_a_hand_calculation(void)
{
    static const int32_t odd[] = {0, 1, -1, 2, -2}, even[] = {0, 1, -1, 2, -2, -3};
    for (uint32_t k = 0; k < 6u; k++) {
        search.angles = 5u;
        search.lowest = -2;
        CHECK(k == 5u || angle_number(&search, k) == odd[k]);
        search.angles = 6u;
        search.lowest = -3;
        CHECK(angle_number(&search, k) == even[k]);
    }
    static const struct {
        int32_t low;
        uint32_t level;
        double offset;
    } blocks[] = {{3, 0u, 3.0}, {-3, 0u, 3.0}, {0, 0u, 0.0}, {-3, 2u, 0.0}, {-4, 2u, 1.0}, {-9, 3u, 2.0}, {1, 3u, 1.0}};
    for (size_t k = 0; k < sizeof blocks / sizeof *blocks; k++) {
        CHECK_NEAR(nearest_offset(blocks[k].low, blocks[k].level), blocks[k].offset, 0.0);
    }
    CHECK(clamp(-1, 5) == 0 && clamp(0, 5) == 0 && clamp(4, 5) == 4 && clamp(5, 5) == 5 && clamp(6, 5) == 5);
    CHECK(half_cells(EK_R(0.5), EK_R(0.25)) == 2 && half_cells(EK_R(0.49), EK_R(0.25)) == 1);
    CHECK(half_cells(EK_R(31.75), EK_R(0.25)) == 127 && half_cells(EK_R(99.0), EK_R(0.25)) == 127);
    CHECK(to_cell(EK_R(-0.5)) == -1 && to_cell(EK_R(2.5)) == 2);
    CHECK(to_cell(EK_R(-1e10)) == -1073741824 && to_cell(EK_R(1e10)) == 1073741824);
}

/* Blocks are expanded from the highest bound on; of equal ones the one that came first. Motions with a bound not above
 * the best score are not looked at. */
static void the_best_block_lies_on_top(void)
{
    const ek_real xy[] = {EK_R(0.05), EK_R(0.05), EK_R(1.05), EK_R(0.05)}, point[] = {EK_R(0.05), EK_R(0.05)};
    const ek_search_window around = {{EK_R(0.0), EK_R(0.0), EK_R(0.0)}, EK_R(1.2), EK_R(0.2), EK_R(0.0)};
    const ek_search_prior none = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    ek_score_grid_draw(&grid, &thinner, xy, 2u, EK_R(CELL), EK_R(0.0), EK_R(0.0), means, &work);
    CHECK(ek_search_begin(&search, &grid, point, 1u, &around, &none, EK_R(0.01)) == EK_OK);
    search.offset = EK_R(0.0);
    turn_points(&search);
    static const int32_t motions[] = {1, 0, 9, 10, 2, 5};
    static const int32_t sorted[] = {2, 9, 1, 10, 0}; /* scores exp(-2), exp(-1/2) twice, 1 twice; 5 cells off: none */
    for (size_t k = 0; k < 6u; k++) {
        push(&search, 0u, motions[k], 0, 0u);
    }
    CHECK(search.waiting == 5u && search.evaluated == 6u);
    for (size_t k = 0; k < 5u; k++) {
        CHECK(search.stack[k].x == sorted[k]);
    }
    push(&search, 5u, 0, 1, 0u); /* above the others, whatever its bound */
    push(&search, 5u, 1, 1, 0u);
    CHECK(search.waiting == 7u && search.stack[6].y == 1 && search.stack[6].x == 0 && search.stack[5].x == 1);
    search.score = search.stack[0].bound;
    push(&search, 0u, 2, 0, 0u); /* as good as the best score, not better */
    CHECK(search.waiting == 7u);
}

/* A window turned away from the truth by 0.2 rad: the heading is found, and the motion has the score that it is said to. */
static void a_turned_window_finds_the_heading(uint64_t *seed)
{
    const ek_pose origin = {EK_R(0.0), EK_R(0.0), EK_R(0.0)}, there = {EK_R(2.5), EK_R(1.9), EK_R(0.4)};
    const ek_search_prior none = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    const size_t count = room(target, origin, seed);
    ek_work all = ek_work_make(INT64_MAX);
    ek_score_grid_draw(&grid, &thinner, target, count, EK_R(CELL), EK_R(2.0), EK_R(2.0), means, &work);
    for (uint32_t level = 1; level < EK_SCORE_LEVELS; level++) {
        ek_score_grid_raise(&grid, level, &work);
    }
    room(source, there, seed);
    for (int side = -1; side < 2; side += 2) {
        ek_search_window window = {there, EK_R(0.3), EK_R(0.3), EK_R(0.25)};
        window.centre.theta += EK_R(0.2 * side);
        CHECK(ek_search_begin(&search, &grid, source, 120u, &window, &none, EK_R(0.1)) == EK_OK);
        CHECK(ek_search_work(&search, &all) && search.found);
        CHECK_NEAR(search.best.theta, 0.4, 0.03);
        const ek_real score = search.score;
        const ek_search_window found = {search.best, EK_R(0.0), EK_R(0.0), EK_R(0.0)};
        CHECK(ek_search_begin(&search, &grid, source, 120u, &found, &none, EK_R(0.1)) == EK_OK && search.angles == 1u);
        CHECK(ek_search_work(&search, &all) && search.found);
        CHECK_NEAR(search.score, score, 0.01); /* points at the border of a cell may be rounded to the next */
    }
}

/* A single point at 1.1 m turns in 70 steps, one more to the right than to the left: the farthest is found too. */
static void an_even_number_of_headings_is_searched_completely(void)
{
    const ek_real target_xy[] = {EK_R(-1.1), EK_R(0.05)}, point[] = {EK_R(1.1), EK_R(0.0)};
    const ek_search_window around = {{EK_R(0.0), EK_R(0.0), EK_R(0.0)}, EK_R(0.05), EK_R(0.05), EK_PI};
    const ek_search_prior none = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    ek_work all = ek_work_make(INT64_MAX);
    ek_score_grid_draw(&grid, &thinner, target_xy, 1u, EK_R(CELL), EK_R(0.0), EK_R(0.0), means, &work);
    for (uint32_t level = 1; level < EK_SCORE_LEVELS; level++) {
        ek_score_grid_raise(&grid, level, &work);
    }
    CHECK(ek_search_begin(&search, &grid, point, 1u, &around, &none, EK_R(0.1)) == EK_OK && search.angles == 70u);
    CHECK(ek_search_work(&search, &all) && search.found);
    CHECK_NEAR(search.score, exhaustive(&search), TOLERANCE);
    CHECK(EK_FABS(search.best.theta) > EK_R(3.0));
    const ek_real beyond[] = {EK_R(1e9), EK_R(-1e9), EK_R(-1e9), EK_R(1e9)}; /* more cells than 32 bits hold */
    const ek_search_window wide = {{EK_R(0.0), EK_R(0.0), EK_R(0.0)}, EK_R(20.0), EK_R(15.0), EK_R(0.0)};
    CHECK(ek_search_begin(&search, &grid, beyond, 2u, &wide, &none, EK_R(0.1)) == EK_OK);
    CHECK(search.half_x == EK_SEARCH_MAX_HALF && search.half_y == EK_SEARCH_MAX_HALF && search.angles == 1u);
    CHECK(ek_search_work(&search, &all) && !search.found);
}

/* Four motions of the middle angle fit alike: that of the lowest x, then of the lowest y, is the answer. */
static void of_equal_scores_the_first_is_found(void)
{
    const ek_real corners[] = {EK_R(-0.25), EK_R(-0.35), EK_R(-0.25), EK_R(0.35), EK_R(0.35), EK_R(-0.35), EK_R(0.35), EK_R(0.35)};
    const ek_real point[] = {EK_R(0.05), EK_R(0.05)};
    const ek_search_window around = {{EK_R(0.0), EK_R(0.0), EK_R(0.0)}, EK_R(0.5), EK_R(0.5), EK_R(0.0)};
    const ek_search_prior none = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    ek_work all = ek_work_make(INT64_MAX);
    ek_score_grid_draw(&grid, &thinner, corners, 4u, EK_R(CELL), EK_R(0.0), EK_R(0.0), means, &work);
    for (uint32_t level = 1; level < EK_SCORE_LEVELS; level++) {
        ek_score_grid_raise(&grid, level, &work);
    }
    CHECK(ek_search_begin(&search, &grid, point, 1u, &around, &none, EK_R(0.1)) == EK_OK && search.angles == 1u);
    CHECK(ek_search_work(&search, &all) && search.found);
    CHECK_NEAR(search.score, 1.0, TOLERANCE);
    CHECK_NEAR(search.best.x, -0.3, 1e-6);
    CHECK_NEAR(search.best.y, -0.4, 1e-6);
}

/* Nothing near the place: an empty grid. Corners of the world in cells of 1 mm: 62 bits of cell number are sorted. */
static void far_points_are_left_out_and_far_cells_are_sorted(void)
{
    const ek_real two[] = {EK_R(-500.0), EK_R(0.0), EK_R(900.0), EK_R(900.0)};
    const ek_real corners[] = {EK_R(1e6), EK_R(1e6), EK_R(-1e6), EK_R(1e6), EK_R(1e6), EK_R(-1e6), EK_R(-1e6), EK_R(-1e6)};
    static const size_t order[] = {3u, 1u, 2u, 0u};
    ek_score_grid_draw(&grid, &thinner, two, 2u, EK_R(CELL), EK_R(0.0), EK_R(0.0), means, &work);
    CHECK(grid.columns == 1 && grid.rows == 1 && grid.level[0][0] == 0u);
    CHECK(ek_thin(&thinner, corners, 4u, EK_R(0.001), means, &work) == 4u);
    for (size_t k = 0; k < 4u; k++) {
        CHECK_NEAR(means[2u * k], corners[2u * order[k]], 0.0);
        CHECK_NEAR(means[2u * k + 1u], corners[2u * order[k] + 1u], 0.0);
    }
}

static void a_target_that_does_not_fit_is_cropped_around_the_place(void)
{
    const ek_real xy[] = {EK_R(-500.0), EK_R(0.0), EK_R(3.05), EK_R(2.05), EK_R(900.0), EK_R(900.0)};
    ek_score_grid_draw(&grid, &thinner, xy, 3u, EK_R(CELL), EK_R(2.0), EK_R(2.0), means, &work);
    CHECK((size_t)grid.columns * (size_t)grid.rows <= CELLS);
    uint32_t full = 0u;
    for (int32_t k = 0; k < grid.columns * grid.rows; k++) {
        full += grid.level[0][k] == 255u;
    }
    CHECK(full == 1u);
    ek_score_grid_draw(&grid, &thinner, xy, 1u, EK_R(CELL), EK_R(2.0), EK_R(2.0), means, &work);
    CHECK(grid.columns > 1); /* a single point fits, wherever it is */
}

int main(void)
{
    ek_arena measured = ek_arena_make(NULL, 0u), taken = measured, *arena = &measured;
    uint64_t seed = 3u;
    for (int pass = 0; pass < 2; pass++) {
        CHECK(ek_thinner_init(&thinner, arena, CAPACITY) == EK_OK);
        CHECK(ek_score_grid_init(&grid, arena, CELLS) == EK_OK && ek_search_init(&search, arena, CAPACITY) == EK_OK);
        if (pass == 0) {
            taken = memory_of(measured.used);
            arena = &taken;
        }
    }
    CHECK(ek_arena_check(arena) == EK_OK);
    work = ek_work_make(INT64_MAX);
    means_of_cells_are_those_of_a_hand_calculation();
    cells_are_found_wherever_they_lie(&seed);
    scores_and_their_maxima_are_those_of_a_hand_calculation();
    the_best_score_is_that_of_an_exhaustive_search(&seed);
    a_target_that_does_not_fit_is_cropped_around_the_place();
    an_even_number_of_headings_is_searched_completely();
    far_points_are_left_out_and_far_cells_are_sorted();
    of_equal_scores_the_first_is_found();
    parts_of_a_search_are_those_of_a_hand_calculation();
    the_best_block_lies_on_top();
    a_turned_window_finds_the_heading(&seed);
    CHECK(ek_thinner_init(&thinner, &measured, 0u) == EK_OUT_OF_RANGE);
    CHECK(ek_score_grid_init(&grid, &measured, 100u) == EK_OUT_OF_RANGE);
    free(taken.memory);
    return verdict();
}

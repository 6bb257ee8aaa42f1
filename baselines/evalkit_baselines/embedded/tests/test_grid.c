#include "check.h"
#include "ek/grid.h"

static ek_grid grid;
static const ek_pose origin = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};

static int16_t *cell(int32_t column, int32_t row)
{
    return grid.cells + (size_t)(row - grid.bottom) * grid.parameters.columns + (size_t)(column - grid.left);
}

static size_t observed(void)
{
    size_t count = 0;
    for (size_t k = 0; k < (size_t)grid.parameters.columns * grid.parameters.rows; k++) {
        count += grid.cells[k] != EK_UNKNOWN;
    }
    return count;
}

static ek_status add(double start_x, double start_y, double x, double y)
{
    const ek_real hit[2] = {EK_R(x), EK_R(y)};
    return ek_grid_add_scan(&grid, origin, EK_R(start_x), EK_R(start_y), hit, 1u, NULL, 0u);
}

static void one_beam_frees_its_cells_and_fills_the_last(void)
{
    ek_grid_clear(&grid);
    CHECK(add(0.5, 0.5, 5.5, 0.5) == EK_OK);
    CHECK(observed() == 6u && grid.touched_cells == 6u && *cell(5, 0) == 847);
    for (int32_t k = 0; k < 5; k++) {
        CHECK(*cell(k, 0) == -847);
    }
    for (int k = 0; k < 10; k++) {
        CHECK(add(0.5, 0.5, 5.5, 0.5) == EK_OK);
    }
    CHECK(*cell(5, 0) == 5000 && *cell(2, 0) == -5000); /* clamped */
}

/* Expected cells by hand: a line through (0.5, 0.5) and (3.5, 1.5) rises one row half-way, at x = 2. */
static void crossed_cells_are_exact(void)
{
    ek_grid_clear(&grid);
    CHECK(add(0.5, 0.5, 3.5, 1.6) == EK_OK);
    CHECK(observed() == 5u && *cell(0, 0) == -847 && *cell(1, 0) == -847 && *cell(1, 1) == -847);
    CHECK(*cell(2, 1) == -847 && *cell(3, 1) == 847);
    ek_grid_clear(&grid);
    CHECK(add(0.5, 0.5, -2.5, -2.5) == EK_OK); /* through corners: diagonally */
    CHECK(observed() == 4u && *cell(-1, -1) == -847 && *cell(-3, -3) == 847);
}

static void steep_and_flat_beams_mirror_each_other(void)
{
    uint64_t seed = 3u;
    for (int k = 0; k < 200; k++) {
        const double u = (double)uniform(&seed, -30.0, 30.0), v = (double)uniform(&seed, -30.0, 30.0);
        ek_grid_clear(&grid);
        CHECK(add(0.3, 0.3, u, v) == EK_OK);
        const size_t crossed = observed();
        const double expected = fabs(floor(u)) + fabs(floor(v)) + 1.0; /* one per grid line crossed, plus the first */
        CHECK((double)crossed == expected);
        ek_grid_clear(&grid);
        CHECK(add(0.3, 0.3, v, u) == EK_OK && observed() == crossed);
        CHECK(*cell((int32_t)floor(v), (int32_t)floor(u)) == 847);
    }
}

/* Beams in the frame of a base that stands anywhere, at any heading, change the cells of the same beams in the world. */
static void the_pose_of_the_base_turns_and_moves_its_beams(void)
{
    static int16_t cells[256u * 256u];
    uint64_t seed = 5u;
    for (int k = 0; k < 40; k++) {
        const ek_pose base = {uniform(&seed, -20.0, 20.0), uniform(&seed, -20.0, 20.0), uniform(&seed, -3.1, 3.1)};
        const ek_real c = EK_COS(base.theta), s = EK_SIN(base.theta);
        ek_real points[10], moved[10]; /* the sensor, two hits, two misses */
        for (size_t i = 0; i < 10u; i += 2u) {
            points[i] = uniform(&seed, -15.0, 15.0);
            points[i + 1u] = uniform(&seed, -15.0, 15.0);
            moved[i] = base.x + c * points[i] - s * points[i + 1u];
            moved[i + 1u] = base.y + s * points[i] + c * points[i + 1u];
        }
        ek_grid_clear(&grid);
        CHECK(ek_grid_add_scan(&grid, origin, moved[0], moved[1], moved + 2, 2u, moved + 6, 2u) == EK_OK);
        const size_t crossed = observed();
        memcpy(cells, grid.cells, sizeof cells);
        ek_grid_clear(&grid);
        CHECK(ek_grid_add_scan(&grid, base, points[0], points[1], points + 2, 2u, points + 6, 2u) == EK_OK);
        CHECK(observed() == crossed && crossed > 4u && memcmp(cells, grid.cells, sizeof cells) == 0);
        CHECK(*cell((int32_t)EK_FLOOR(moved[2]), (int32_t)EK_FLOOR(moved[3])) == 847);
    }
}

static void occupied_wins_and_counts_once(void)
{
    const ek_real hits[] = {EK_R(3.5), EK_R(0.5), EK_R(7.5), EK_R(0.5), EK_R(7.6), EK_R(0.4)};
    const ek_real miss[] = {EK_R(0.5), EK_R(9.5)};
    ek_grid_clear(&grid);
    CHECK(ek_grid_add_scan(&grid, origin, EK_R(0.5), EK_R(0.5), hits, 3u, miss, 1u) == EK_OK);
    CHECK(*cell(3, 0) == 847 && *cell(7, 0) == 847 && *cell(5, 0) == -847);
    CHECK(*cell(0, 9) == -847 && *cell(0, 10) == EK_UNKNOWN);
}

static void a_fixed_map_clips_and_a_rolling_one_follows(void)
{
    const ek_real hit[] = {EK_R(10.5), EK_R(0.5)};
    const ek_pose away = {EK_R(120.0), EK_R(-100.0), EK_R(0.0)}, lost = {EK_R(1e9), EK_R(0.0), EK_R(0.0)};
    ek_grid_clear(&grid);
    CHECK(ek_grid_add_scan(&grid, away, EK_R(0.5), EK_R(0.5), hit, 1u, NULL, 0u) == EK_OK);
    CHECK(observed() == 8u && *cell(127, -100) == -847); /* 120 to 127 of 120 to 130 */
    grid.parameters.rolling = 1;
    CHECK(ek_grid_add_scan(&grid, away, EK_R(0.5), EK_R(0.5), hit, 1u, NULL, 0u) == EK_OK);
    CHECK(observed() == 11u && *cell(127, -100) == -1694 && *cell(130, -100) == 847);
    CHECK(ek_grid_add_scan(&grid, origin, EK_R(0.5), EK_R(0.5), hit, 1u, NULL, 0u) == EK_OK);
    CHECK(*cell(10, 0) == 847);
    CHECK(ek_grid_add_scan(&grid, lost, EK_R(0.5), EK_R(0.5), hit, 1u, NULL, 0u) == EK_OUT_OF_RANGE);
    grid.parameters.rolling = 0;
}

/* The window of 128 + 1 + 31 cells moves by words; a rolling map keeps what stays inside and drops the rest. */
static void a_rolling_map_keeps_what_stays_inside(void)
{
    static const double moves[][2] = {{40.0, 0.0}, {-40.0, 0.0}, {0.0, 40.0}, {0.0, -40.0}, {300.0, 0.0}, {0.0, 300.0}};
    const ek_real hit[] = {EK_R(5.5), EK_R(0.5)};
    for (size_t k = 0; k < sizeof moves / sizeof *moves; k++) {
        const ek_pose away = {EK_R(moves[k][0]), EK_R(moves[k][1]), EK_R(0.0)}, near = {EK_R(1.0), EK_R(0.0), EK_R(0.0)};
        const int far = fabs(moves[k][0]) + fabs(moves[k][1]) > 100.0;
        ek_grid_clear(&grid);
        grid.parameters.rolling = 1;
        CHECK(ek_grid_add_scan(&grid, origin, EK_R(0.5), EK_R(0.5), hit, 1u, NULL, 0u) == EK_OK);
        const int32_t left = grid.left, bottom = grid.bottom;
        CHECK(ek_grid_add_scan(&grid, near, EK_R(0.5), EK_R(0.5), hit, 1u, NULL, 0u) == EK_OK);
        CHECK(grid.left == left && grid.bottom == bottom && observed() == 7u); /* not moved for a step of 1 m */
        CHECK(ek_grid_add_scan(&grid, away, EK_R(0.5), EK_R(0.5), hit, 1u, NULL, 0u) == EK_OK);
        CHECK(observed() == (far ? 6u : 13u));
        CHECK(*cell((int32_t)moves[k][0] + 5, (int32_t)moves[k][1]) == 847);
        CHECK(far || (*cell(6, 0) == 847 && *cell(0, 0) == -847));
        grid.parameters.rolling = 0;
    }
}

/* Seen from beyond each side, a fixed map takes the cells that lie in it. */
static void a_fixed_map_takes_its_own_cells_from_every_side(void)
{
    static const double sides[][2] = {{-131.5, 0.5}, {130.5, 0.5}, {0.5, -131.5}, {0.5, 130.5}};
    for (size_t k = 0; k < 4u; k++) {
        const double x = sides[k][0], y = sides[k][1];
        ek_grid_clear(&grid);
        CHECK(add(x, y, x + (k == 0u ? 10.0 : k == 1u ? -10.0 : 0.0), y + (k == 2u ? 10.0 : k == 3u ? -10.0 : 0.0)) == EK_OK);
        CHECK(observed() == (k % 2u ? 8u : 7u) && grid.ignored_beams == 0u && grid.touched_cells == observed());
    }
    ek_grid_clear(&grid);
    for (int32_t sign = -1; sign < 2; sign += 2) { /* ends outside the window on each side */
        CHECK(add(0.5, 0.5, 90.0 * sign, 0.5) == EK_OK && grid.ignored_beams == 1u);
        CHECK(add(0.5, 0.5, 0.5, 90.0 * sign) == EK_OK && grid.ignored_beams == 1u);
    }
    CHECK(observed() == 0u);
}

/* A block of 32 x 32 cells: the marks of rows and columns together, and not those of the next block. */
static void a_block_is_read_from_its_own_rows(void)
{
    uint32_t across[128], along[128], crossed[33];
    ek_window window = {64u, 2u, across, along, NULL, NULL, {0u, 0u, 0u, 0u}, 0u, 0u, 0};
    memset(across, 0, sizeof across);
    memset(along, 0, sizeof along);
    memset(crossed, 0, sizeof crossed);
    across[2u * 9u] = 1u << 7;         /* column 7 of row 9 */
    along[2u * 3u] = 1u << 5;          /* row 5 of column 3 */
    across[2u * 32u] = across[1] = ~0u; /* the blocks above and beside it */
    along[2u * 32u] = along[1] = ~0u;
    ek_window_read_block(&window, 0u, 0u, crossed);
    for (size_t k = 0; k < 33u; k++) {
        CHECK(crossed[k] == (k == 9u ? 1u << 7 : k == 5u ? 1u << 3 : 0u));
    }
}

/* The marks of a scan lie in the cells that it says, and none is left after they are cleared. */
static void marks_lie_between_the_start_and_the_ends(void)
{
    uint32_t bits[4][64u * 2u];
    ek_window window = {64u, 2u, bits[0], bits[1], bits[2], bits[3], {0u, 0u, 0u, 0u}, 0u, 0u, 0};
    const ek_view view = {EK_R(1.0), EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(40.5), EK_R(20.5)};
    const ek_real flat[] = {EK_R(50.5), EK_R(17.5)}, steep[] = {EK_R(35.5), EK_R(30.5)}, outside[] = {EK_R(64.5), EK_R(1.5)};
    ek_window_init(&window);
    CHECK(window.marks.left > window.marks.right && window.steep_left > window.steep_right);
    CHECK(ek_window_mark_beams(&window, &view, outside, 1u, 1) == 1u && window.marks.left > window.marks.right);
    CHECK(ek_window_mark_beams(&window, &view, flat, 1u, 1) == 0u && window.steep_left > window.steep_right);
    CHECK(window.marks.left == 40u && window.marks.right == 50u && window.marks.bottom == 17u && window.marks.top == 20u);
    CHECK(ek_window_mark_beams(&window, &view, steep, 1u, 1) == 0u);
    CHECK(window.steep_left == 35u && window.steep_right == 40u);
    CHECK(window.marks.left == 35u && window.marks.right == 50u && window.marks.bottom == 17u && window.marks.top == 30u);
    ek_window_clear(&window);
    CHECK(window.marks.left > window.marks.right && window.steep_left > window.steep_right);
    for (size_t k = 0; k < 4u * 128u; k++) {
        CHECK(bits[k / 128u][k % 128u] == 0u);
    }
}

/* The loops for AVX2 and those for every processor draw the same map; scans of several sizes take turns. */
static void both_copies_of_the_loops_draw_the_same(ek_grid_parameters parameters)
{
    static ek_grid drawn[2];
    uint64_t seed = 11u;
    parameters.range_max = EK_R(110.0);
    for (int polygon = 0; polygon < 2; polygon++) {
        parameters.polygon = polygon;
        ek_arena arena = memory_of(900000u);
        for (int wide = 0; wide < 2; wide++) {
            CHECK(ek_grid_init(&drawn[wide], &arena, &parameters) == EK_OK && ek_arena_check(&arena) == EK_OK);
            drawn[wide].window.wide = wide ? drawn[wide].window.wide : 0;
        }
        for (int k = 0; k < 40; k++) {
            ek_real hits[2u * 60u];
            const double size = (double)uniform(&seed, 2.0, 105.0);
            const int even = k % 4 == 0; /* from the middle of a cell to that of another: through many corners */
            const ek_pose middle = {EK_R(0.5), EK_R(0.5), EK_R(0.0)};
            const ek_pose anywhere = {uniform(&seed, -60.0, 60.0), uniform(&seed, -60.0, 60.0), uniform(&seed, -3.0, 3.0)};
            for (size_t j = 0; j < 60u; j++) {
                const double range = size * (double)uniform(&seed, j % 7u ? 0.8 : 0.2, 1.0), angle = 0.1 * (double)j;
                hits[2u * j] = even ? EK_FLOOR(EK_R(range * cos(angle))) : EK_R(range * cos(angle));
                hits[2u * j + 1u] = even && j % 3u ? EK_FLOOR(EK_R(range * sin(angle))) : EK_R(range * sin(angle));
                hits[2u * j + 1u] = even && j % 3u == 0u ? hits[2u * j] : hits[2u * j + 1u]; /* diagonal */
            }
            for (int wide = 0; wide < 2; wide++) {
                CHECK(ek_grid_add_scan(&drawn[wide], even ? middle : anywhere, EK_R(0), EK_R(0), hits, 60u, NULL, 0u) == EK_OK);
            }
            CHECK(drawn[0].touched_cells == drawn[1].touched_cells && drawn[0].touched_cells > 0u);
        }
        CHECK(memcmp(drawn[0].cells, drawn[1].cells, (size_t)256u * 256u * sizeof(int16_t)) == 0);
        free(arena.memory);
    }
}

/* Beams across 590 cells and 16 to 128 lines: some lines fill whole words. Their number is one of each line and each
 * column that is crossed, without the corners; both copies of the loops mark the same. */
static void long_beams_fill_whole_words(void)
{
    enum { SIDE = 1216, ALL = SIDE * SIDE / 32 };
    static uint32_t bits[2][3][ALL];
    const ek_view view = {EK_R(1.0), EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(600.25), EK_R(600.25)};
    const int lines[] = {16, 62, 63, 64, 127, 128};
    for (size_t k = 0; k < 6u * 8u; k++) {
        const double along = k & 1u ? 590.0 : -590.0, aside = k & 2u ? lines[k / 8u] : -lines[k / 8u];
        const double x = 600.25 + (k & 4u ? along : aside), y = 600.25 + (k & 4u ? aside : along);
        const ek_real end[] = {EK_R(x), EK_R(y)};
        size_t marked[2] = {0u, 0u};
        for (int wide = 0; wide < 2; wide++) {
            ek_window window = {SIDE, SIDE / 32, bits[wide][0], bits[wide][1], bits[wide][2], bits[wide][2],
                                {0u, 0u, 0u, 0u}, 0u, 0u, 0};
            ek_window_init(&window);
            window.wide = wide ? window.wide : 0;
            CHECK(ek_window_mark_beams(&window, &view, end, 1u, 0) == 0u);
            for (size_t word = 0; word < ALL; word++) {
                for (uint32_t left = bits[wide][k & 4u ? 0 : 1][word]; left; left &= left - 1u) {
                    marked[wide]++;
                }
            }
        }
        CHECK(memcmp(bits[0], bits[1], sizeof bits[0]) == 0);
        CHECK(marked[0] <= 591u + (size_t)lines[k / 8u] && marked[0] > 590u && marked[1] == marked[0]);
    }
}

static void bad_input_is_named(void)
{
    ek_grid_parameters bad = grid.parameters;
    ek_arena none = ek_arena_make(NULL, 0u);
    ek_grid other;
    CHECK(add((double)NAN, 0.0, 1.0, 1.0) == EK_NOT_FINITE && add(0.0, 0.0, 1.0, (double)INFINITY) == EK_NOT_FINITE);
    CHECK(add(0.0, 0.0, 70.0, 0.0) == EK_OK && grid.ignored_beams == 1u);
    CHECK(ek_grid_add_scan(&grid, origin, EK_R(0), EK_R(0), NULL, 1u, NULL, 0u) == EK_NULL_POINTER);
    const ek_real broken[] = {EK_R(0.0), (ek_real)NAN};
    CHECK(ek_grid_add_scan(&grid, origin, EK_R(0), EK_R(0), NULL, 0u, broken, 1u) == EK_NOT_FINITE);
    CHECK(ek_grid_add_scan(&grid, origin, EK_R(0), EK_R(0), NULL, 0u, NULL, 1u) == EK_NULL_POINTER);
    CHECK(add(0.0, (double)NAN, 1.0, 1.0) == EK_NOT_FINITE);
    const ek_pose turned = {EK_R(0.0), EK_R(0.0), (ek_real)NAN}, above = {EK_R(0.0), EK_R(1.1e6), EK_R(0.0)};
    CHECK(ek_grid_add_scan(&grid, turned, EK_R(0), EK_R(0), NULL, 0u, NULL, 0u) == EK_NOT_FINITE);
    CHECK(ek_grid_add_scan(&grid, above, EK_R(0), EK_R(0), NULL, 0u, NULL, 0u) == EK_OUT_OF_RANGE);
    bad.columns = 100u;
    CHECK(ek_grid_init(&other, &none, &bad) == EK_OUT_OF_RANGE);
    bad.columns = 64u;
    bad.rolling = 1;
    CHECK(ek_grid_init(&other, &none, &bad) == EK_OUT_OF_RANGE); /* smaller than one scan */
}

int main(void)
{
    ek_arena arena = memory_of(400000u);
    ek_grid_parameters parameters = ek_grid_default();
    parameters.resolution = EK_R(1.0);
    parameters.range_max = EK_R(45.0);
    parameters.columns = parameters.rows = 256u;
    parameters.left = parameters.bottom = -128;
    CHECK(ek_grid_init(&grid, &arena, &parameters) == EK_OK && ek_arena_check(&arena) == EK_OK);
    one_beam_frees_its_cells_and_fills_the_last();
    crossed_cells_are_exact();
    steep_and_flat_beams_mirror_each_other();
    the_pose_of_the_base_turns_and_moves_its_beams();
    occupied_wins_and_counts_once();
    a_fixed_map_clips_and_a_rolling_one_follows();
    a_rolling_map_keeps_what_stays_inside();
    a_fixed_map_takes_its_own_cells_from_every_side();
    a_block_is_read_from_its_own_rows();
    marks_lie_between_the_start_and_the_ends();
    both_copies_of_the_loops_draw_the_same(parameters);
    long_beams_fill_whole_words();
    bad_input_is_named();
    free(arena.memory);
    return verdict();
}

#include "check.h"
#include "ek/grid.h"
#include "ek/polygon.h"

#define BEAMS 400u
#define SIDE 256u

static ek_grid grid;
static ek_real ends[4u * BEAMS];

static void use(ek_real widest_gap, ek_arena *arena)
{
    ek_grid_parameters parameters = ek_grid_default();
    parameters.columns = parameters.rows = SIDE;
    parameters.left = parameters.bottom = -(int32_t)SIDE / 2;
    parameters.resolution = EK_R(0.1);
    parameters.range_max = EK_R(10.0);
    parameters.polygon = 1;
    parameters.widest_gap = widest_gap;
    arena->used = 0u;
    CHECK(ek_grid_init(&grid, arena, &parameters) == EK_OK && ek_arena_check(arena) == EK_OK);
}

/* Ends of a scan of a round room with a wave in its wall; `turns` of BEAMS beams each, clockwise if negative. */
static size_t round_room(int turns, double wave)
{
    const size_t count = (size_t)abs(turns) * BEAMS;
    for (size_t k = 0; k < count; k++) {
        const double angle = (turns < 0 ? -2.0 : 2.0) * (double)EK_PI * ((double)k + 0.25) / BEAMS;
        const double range = 6.0 + wave * sin(5.0 * angle);
        ends[2u * k] = EK_R(range * cos(angle));
        ends[2u * k + 1u] = EK_R(range * sin(angle));
    }
    return count;
}

static void add(size_t count)
{
    const ek_pose pose = {EK_R(0.031), EK_R(-0.017), EK_R(0.0)};
    ek_grid_clear(&grid);
    CHECK(ek_grid_add_scan(&grid, pose, EK_R(0.0), EK_R(0.0), ends, count, NULL, 0u) == EK_OK);
    for (size_t k = 0; k < (size_t)grid.window.lines * grid.window.words; k++) {
        CHECK(grid.window.outline[k] == 0u);
    }
}

/* 1 if the point lies in the triangle of the sensor and the ends of beams a and b, 0 if not, -1 if too close to tell. */
static int is_between(size_t a, size_t b, double x, double y)
{
    const double ax = (double)ends[2u * a], ay = (double)ends[2u * a + 1u], bx = (double)ends[2u * b],
                 by = (double)ends[2u * b + 1u];
    const double turn = ax * by - ay * bx < 0.0 ? -1.0 : 1.0, close = 1e-4;
    const double sides[3] = {turn * (ax * y - ay * x), turn * (x * by - y * bx),
                             turn * ((bx - ax) * (y - ay) - (by - ay) * (x - ax))};
    const double least = fmin(sides[0], fmin(sides[1], sides[2]));
    return least > close ? 1 : least < -close ? 0 : -1;
}

/* A cell that is not hit is free if its centre lies between two neighbouring beams, and unknown if not. */
static void cells_between_neighbouring_beams_are_free(size_t count, int closed)
{
    unsigned free_cells = 0u, wrong = 0u;
    for (size_t row = 0; row < SIDE; row++) {
        for (size_t column = 0; column < SIDE; column++) {
            const double x = ((double)column - SIDE / 2 + 0.5) * 0.1 - 0.031;
            const double y = ((double)row - SIDE / 2 + 0.5) * 0.1 + 0.017;
            int inside = 0, close = 0;
            for (size_t k = 0; k + (closed ? 0u : 1u) < count; k++) {
                const int now = is_between(k, (k + 1u) % count, x, y);
                inside |= now == 1;
                close |= now < 0;
            }
            for (size_t k = 0; !closed && k < count; k += count - 1u) { /* the beams at both ends are also drawn */
                const double u = (double)ends[2u * k], v = (double)ends[2u * k + 1u];
                close |= u * x + v * y > 0.0 && fabs(u * y - v * x) < 0.15 * sqrt(u * u + v * v);
            }
            close |= x * x + y * y < 0.04;
            const int16_t cell = grid.cells[row * SIDE + column];
            free_cells += cell < 0 && cell != EK_UNKNOWN;
            wrong += !(cell > 0 || close || (cell == (inside ? -847 : EK_UNKNOWN)));
        }
    }
    CHECK(wrong == 0u && free_cells > 1000u);
}

static uint64_t sum_of_cells(void)
{
    uint64_t sum = 14695981039346656037u; /* Fowler, Noll, Vo 1a */
    for (size_t k = 0; k < SIDE * SIDE; k++) {
        sum = (sum ^ (uint64_t)(uint16_t)grid.cells[k]) * 1099511628211u;
    }
    return sum;
}

static void the_direction_and_the_number_of_turns_do_not_matter(void)
{
    add(round_room(1, 0.8));
    cells_between_neighbouring_beams_are_free(BEAMS, 1);
    const uint64_t once = sum_of_cells();
    add(round_room(2, 0.8));
    CHECK(sum_of_cells() == once);
    add(round_room(-1, 0.8));
    cells_between_neighbouring_beams_are_free(BEAMS, 1);
    add(round_room(1, 0.8) / 3u);
    cells_between_neighbouring_beams_are_free(BEAMS / 3u, 0);
}

/* Cell of a place given by angle (rad) and range (m). */
static int16_t cell_at(double angle, double range)
{
    const double x = range * cos(angle) + 0.031, y = range * sin(angle) - 0.017;
    return grid.cells[(size_t)(y / 0.1 + SIDE / 2) * SIDE + (size_t)(x / 0.1 + SIDE / 2)];
}

static void a_gap_is_not_filled_and_an_edge_is_cut(void)
{
    size_t count = 0u;
    for (size_t k = 0; k < BEAMS; k++) { /* nothing from 1 to 1.5 rad; near from 3 to 4 rad; one single beam at 1.25 */
        const double angle = 2.0 * (double)EK_PI * (double)k / BEAMS, range = angle > 3.0 && angle < 4.0 ? 3.0 : 8.0;
        if (angle < 1.0 || angle > 1.5 || (angle > 1.25 && angle < 1.265)) {
            ends[2u * count] = EK_R(range * cos(angle));
            ends[2u * count++ + 1u] = EK_R(range * sin(angle));
        }
    }
    add(count);
    CHECK(cell_at(1.1, 5.0) == EK_UNKNOWN && cell_at(1.4, 5.0) == EK_UNKNOWN);
    CHECK(cell_at(1.2566, 5.0) == -847 && cell_at(0.5, 5.0) == -847 && cell_at(2.0, 5.0) == -847);
    CHECK(cell_at(3.5, 2.0) == -847 && cell_at(3.5, 5.0) == EK_UNKNOWN);
    CHECK(cell_at(3.03, 5.0) == EK_UNKNOWN && cell_at(3.97, 5.0) == EK_UNKNOWN);
    CHECK(cell_at(2.95, 5.0) == -847 && cell_at(4.05, 5.0) == -847);
}

/* Beams that end outside the window count as left out, on each side of it; the others are as without them. */
static void ends_outside_the_window_are_left_out(void)
{
    add(round_room(1, 0.8));
    const uint64_t alone = sum_of_cells();
    const size_t count = round_room(1, 0.8);
    for (size_t k = 0; k < 8u; k++) {
        ends[2u * (count + k)] = EK_R(k % 2u ? 0.0 : k < 4u ? -40.0 : 40.0);
        ends[2u * (count + k) + 1u] = EK_R(k % 2u ? (k < 4u ? -40.0 : 40.0) : 0.0);
    }
    add(count + 8u);
    CHECK(grid.ignored_beams == 8u && sum_of_cells() == alone);
}

/* Ends in the last cells of the window. */
static void the_last_cells_of_the_window_are_marked(void)
{
    const double last = 0.1 * ((double)grid.window.lines / 2.0) - 0.02;
    size_t count = 0u;
    for (double v = -1.0; v < 1.0; v += 0.05, count++) {
        ends[2u * count] = EK_R(last - 1.6);
        ends[2u * count + 1u] = EK_R(v);
    }
    add(count);
    CHECK(grid.ignored_beams == 0u && cell_at(0.0, last - 1.6) == 847 && cell_at(0.0, 5.0) == -847);
}

/* A window of 64 cells, seen from its middle: ends in the first cells count, also on their outer sides; those on the outer
 * sides of the last cells do not. */
static void the_first_cells_of_the_window_are_marked(void)
{
    static const double places[][2] = {{-31.5, 0.5}, {-32.0, -20.5}, {0.5, -31.5}, {20.5, -32.0},
                                       {31.5, 0.5},  {32.0, 20.5},   {0.5, 31.5},  {-20.5, 32.0}};
    uint32_t bits[4][128];
    ek_window window = {64u, 2u, bits[0], bits[1], bits[2], bits[3], {0u, 0u, 0u, 0u}, 0u, 0u, 0};
    const ek_view view = {EK_R(1.0), EK_R(0.0), EK_R(32.0), EK_R(32.0), EK_R(32.0), EK_R(32.0)};
    for (size_t k = 0; k < 8u; k++) {
        const ek_real end[] = {EK_R(places[k][0]), EK_R(places[k][1])};
        const int outside = places[k][0] >= 32.0 || places[k][1] >= 32.0;
        ek_window_init(&window);
        CHECK(ek_window_fill_outline(&window, &view, end, 1u, EK_R(0.05)) == (uint32_t)outside);
        const uint32_t column = (uint32_t)(places[k][0] + 32.0), row = (uint32_t)(places[k][1] + 32.0);
        CHECK(outside || bits[2][2u * row + column / 32u] == (uint32_t)1 << column % 32u);
    }
}

static void few_beams_are_drawn_as_beams(void)
{
    add(0u);
    CHECK(grid.touched_cells == 0u);
    for (size_t count = 1; count < 4u; count++) {
        for (size_t k = 0; k < count; k++) {
            ends[2u * k] = EK_R(5.0 * cos(2.0 * (double)k));
            ends[2u * k + 1u] = EK_R(5.0 * sin(2.0 * (double)k));
        }
        add(count);
        for (size_t k = 0; k < count; k++) {
            CHECK(cell_at(2.0 * (double)k, 5.0) == 847 && cell_at(2.0 * (double)k, 2.5) == -847);
        }
    }
    for (size_t k = 0; k < 20u; k++) { /* all at the sensor, then all alike */
        ends[2u * k] = ends[2u * k + 1u] = EK_R(0.0);
    }
    add(20u);
    CHECK(grid.touched_cells == 1u);
    for (size_t k = 0; k < 20u; k++) {
        ends[2u * k] = EK_R(5.0);
    }
    add(20u);
    CHECK(cell_at(0.0, 5.0) == 847 && cell_at(0.0, 2.5) == -847);
}

int main(void)
{
    ek_arena arena = memory_of(1000000u);
    use(EK_R(0.05), &arena);
    the_direction_and_the_number_of_turns_do_not_matter();
    a_gap_is_not_filled_and_an_edge_is_cut();
    ends_outside_the_window_are_left_out();
    the_last_cells_of_the_window_are_marked();
    the_first_cells_of_the_window_are_marked();
    few_beams_are_drawn_as_beams();
    free(arena.memory);
    return verdict();
}

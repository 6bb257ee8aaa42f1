#include "check.h"
#include "ek/index.h"

#define POINTS 1500u

static ek_real cloud[2u * POINTS];
static ek_index reference;

/* Nearest and second nearest distance by brute force. */
static size_t search_all(size_t count, ek_real x, ek_real y, double *nearest, double *second)
{
    size_t at = 0;
    *nearest = *second = 1e30;
    for (size_t k = 0; k < count; k++) {
        const ek_real dx = cloud[2u * k] - x, dy = cloud[2u * k + 1u] - y, squared = dx * dx + dy * dy;
        const double distance = (double)EK_SQRT(squared);
        if (distance < *nearest) {
            *second = *nearest;
            *nearest = distance;
            at = k;
        } else if (distance < *second) {
            *second = distance;
        }
    }
    return at;
}

static void answers_are_those_of_a_search_of_all(size_t count, double limit, uint64_t *seed)
{
    CHECK(ek_index_build(&reference, cloud, count) == EK_OK);
    for (int k = 0; k < 400; k++) {
        const ek_real x = uniform(seed, -3.0, 13.0), y = uniform(seed, -3.0, 8.0);
        double nearest, second;
        const size_t at = search_all(count, x, y, &nearest, &second);
        const ek_neighbour found = ek_index_nearest(&reference, x, y, EK_R(limit), uniform(seed, 0.001, 1.0));
        CHECK((found.slot != EK_NONE) == (EK_R(nearest) < EK_R(limit)));
        if (found.slot != EK_NONE) {
            CHECK(reference.id[found.slot] == at);
            CHECK_NEAR(found.distance, nearest, 0.0);
        }
        CHECK((double)found.others <= (found.slot != EK_NONE ? second : nearest) + (double)reference.cells.margin);
    }
}

static void fill(uint64_t *seed)
{
    for (size_t k = 0; k < POINTS; k++) { /* half on walls, half anywhere, one far away */
        cloud[2u * k] = uniform(seed, 0.0, 10.0);
        cloud[2u * k + 1u] = k % 2u ? uniform(seed, -0.05, 0.05) : uniform(seed, 0.0, 5.0);
    }
    cloud[20] = EK_R(-40.0);
}

static void of_equally_near_points_the_lowest_wins(void)
{
    const ek_real square[] = {EK_R(1),  EK_R(1), EK_R(-1), EK_R(1),  EK_R(-1),
                              EK_R(-1), EK_R(1), EK_R(-1), EK_R(-1), EK_R(1)};
    CHECK(ek_index_build(&reference, square, 5u) == EK_OK);
    CHECK(reference.id[ek_index_nearest(&reference, EK_R(0.0), EK_R(0.0), EK_R(9.0), EK_R(0.1)).slot] == 0u);
    const ek_neighbour twin = ek_index_nearest(&reference, EK_R(-1.1), EK_R(1.0), EK_R(9.0), EK_R(0.5));
    CHECK(reference.id[twin.slot] == 1u);
    CHECK_NEAR(twin.others, 0.1, TOLERANCE);
}

/* Rounding is coarser a thousand kilometres away than near the points: the search must still end. */
static void from_far_away_the_search_ends(void)
{
    const ek_real pair[] = {EK_R(0.0), EK_R(0.0), EK_R(4.0), EK_R(0.0)};
    const ek_real places[] = {EK_R(1e6), EK_R(-1e6), EK_R(12345.678)};
    CHECK(ek_index_build(&reference, pair, 2u) == EK_OK);
    for (size_t k = 0; k < sizeof places / sizeof *places; k++) {
        const ek_neighbour found = ek_index_nearest(&reference, places[k], EK_R(0.0), EK_R(1e12), EK_R(0.1));
        CHECK(found.slot != EK_NONE && reference.id[found.slot] == (places[k] > EK_R(0.0)));
        CHECK_NEAR(found.distance / EK_FABS(places[k]), 1.0, 1e-3);
    }
}

/* Beside the cells, whose border is 1/16 of the width, a search ends at once where the limit does not reach them, and the
 * bound is then their distance. */
static void beside_the_cells_the_bound_is_their_distance(void)
{
    ek_real square[2u * 64u];
    for (size_t k = 0; k < 64u; k++) {
        square[2u * k] = EK_R((double)(k % 8u) / 7.0);
        square[2u * k + 1u] = EK_R((double)(k / 8u) / 7.0);
    }
    CHECK(ek_index_build(&reference, square, 64u) == EK_OK);
    static const double places[4][2] = {{10.0, 0.5}, {-9.0, 0.5}, {0.5, 10.0}, {0.2, -9.0}};
    for (size_t k = 0; k < 4u; k++) {
        const ek_real x = EK_R(places[k][0]), y = EK_R(places[k][1]);
        const ek_neighbour none = ek_index_nearest(&reference, x, y, EK_R(2.0), EK_R(0.1));
        CHECK(none.slot == EK_NONE && none.others > EK_R(8.0) && none.others <= EK_R(9.0));
        const ek_neighbour found = ek_index_nearest(&reference, x, y, EK_R(20.0), EK_R(0.1));
        CHECK(found.slot != EK_NONE && found.distance >= EK_R(9.0) && found.distance < EK_R(9.01));
        CHECK(found.others >= none.others && found.others <= EK_R(9.02));
    }
}

/* The largest world in the smallest cells: as many cells as there is memory for, at most 2^20 on a side. */
static void cells_cover_the_largest_world(void)
{
    static const double corners[3][4] = {{-1e6, 1e6, -1e6, 1e6}, {-1e6, 1e6, 0.0, 0.0}, {0.0, 0.0, -1e6, 1e6}};
    for (size_t k = 0; k < 3u; k++) {
        const ek_bounds bounds = {EK_R(corners[k][0]), EK_R(corners[k][1]), EK_R(corners[k][2]), EK_R(corners[k][3])};
        const ek_cell_grid grid = ek_cell_grid_fit(&bounds, EK_R(0.001), (size_t)1 << 30);
        const double cells = (double)grid.columns * (double)grid.rows;
        CHECK(ek_cell_grid_contains(&grid, &bounds) && grid.finest && cells <= 1073741824.0);
        CHECK(grid.columns <= 1048576u && grid.rows <= 1048576u);
        CHECK(cells > (k == 0u ? 0.8 * 1073741824.0 : 0.8 * 1048576.0));
    }
}

static void an_empty_or_wide_cloud_is_searched_too(void)
{
    const ek_real wide[] = {EK_R(0.0), EK_R(0.0), EK_R(500.0), EK_R(0.0), EK_R(0.0), EK_R(900.0)};
    CHECK(ek_index_build(&reference, wide, 3u) == EK_OK);
    CHECK(reference.id[ek_index_nearest(&reference, EK_R(400.0), EK_R(1.0), EK_R(1e3), EK_R(0.1)).slot] == 1u);
    CHECK(ek_index_build(&reference, wide + 2, 1u) == EK_OK && ek_index_build(&reference, wide, 2u) == EK_OK);
    CHECK(reference.id[ek_index_nearest(&reference, EK_R(1.0), EK_R(1.0), EK_R(1e3), EK_R(0.1)).slot] == 0u);
}

static void bad_input_is_named(void)
{
    cloud[7] = (ek_real)NAN;
    CHECK(ek_index_build(&reference, cloud, 10u) == EK_NOT_FINITE && reference.count == 0u);
    cloud[7] = EK_R(1e7);
    CHECK(ek_index_build(&reference, cloud, 10u) == EK_OUT_OF_RANGE);
    cloud[7] = EK_R(0.0);
    CHECK(ek_index_build(&reference, cloud, POINTS + 1u) == EK_TOO_MANY_POINTS);
    CHECK(ek_index_build(&reference, NULL, 10u) == EK_NULL_POINTER);
    CHECK(ek_index_build(&reference, cloud, 0u) == EK_OK);
    CHECK(ek_index_nearest(&reference, EK_R(0.0), EK_R(0.0), EK_R(9.0), EK_R(0.1)).slot == EK_NONE);
    ek_arena none = ek_arena_make(NULL, 0u);
    CHECK(ek_index_init(&reference, &none, 0u, 10u) == EK_OUT_OF_RANGE);
}

int main(void)
{
    uint64_t seed = 7u;
    ek_arena arena = memory_of(200000u);
    CHECK(ek_index_init(&reference, &arena, POINTS, 4000u) == EK_OK && ek_arena_check(&arena) == EK_OK);
    fill(&seed);
    answers_are_those_of_a_search_of_all(POINTS, 0.3, &seed);
    answers_are_those_of_a_search_of_all(POINTS, 1e9, &seed);
    cloud[20] = EK_R(5.0);
    for (int k = 0; k < 3; k++) { /* until the cell width is stable */
        answers_are_those_of_a_search_of_all(POINTS, 0.5, &seed);
    }
    answers_are_those_of_a_search_of_all(2u, 1e9, &seed);
    answers_are_those_of_a_search_of_all(1u, 0.5, &seed);
    of_equally_near_points_the_lowest_wins();
    from_far_away_the_search_ends();
    beside_the_cells_the_bound_is_their_distance();
    cells_cover_the_largest_world();
    an_empty_or_wide_cloud_is_searched_too();
    bad_input_is_named();
    free(arena.memory);
    return verdict();
}

#include "check.h"
#include "ek/index_update.h"

#define MAX_COUNT 900u
#define STEPS 250

/* Parameters of the random clouds. */
typedef struct {
    double width, height; /* m */
    double step;          /* m that the cloud moves between two updates */
    double grid;          /* m between allowed coordinates; 0: any coordinate */
    uint32_t points;      /* maximum number per update */
    size_t cells;
} scene;

static ek_index_updater merge;
static ek_index updated, built;
static ek_real cloud[2u * MAX_COUNT];
static size_t held;

static uint32_t below(uint64_t *seed, uint32_t limit)
{
    return (uint32_t)uniform(seed, 0.0, (double)limit);
}

static ek_real place(uint64_t *seed, double size, double grid)
{
    const double at = (double)uniform(seed, 0.0, size);
    return EK_R(grid > 0.0 ? grid * floor(at / grid) : at);
}

/* Compare two indices to the bit. */
static void are_equal(void)
{
    const ek_cell_grid a = updated.cells, b = built.cells;
    CHECK(updated.count == held && built.count == held);
    CHECK(a.columns == b.columns && a.rows == b.rows && a.finest == b.finest);
    CHECK(memcmp(&a.left, &b.left, sizeof a.left) == 0 && memcmp(&a.bottom, &b.bottom, sizeof a.bottom) == 0);
    CHECK(memcmp(&a.cell, &b.cell, sizeof a.cell) == 0 && memcmp(&a.margin, &b.margin, sizeof a.margin) == 0);
    CHECK(updated.occupied == built.occupied || held == 0u);
    CHECK(memcmp(updated.xy, built.xy, 2u * held * sizeof(ek_real)) == 0);
    CHECK(memcmp(updated.id, built.id, held * sizeof(uint32_t)) == 0);
    CHECK(held == 0u || memcmp(updated.start, built.start, ((size_t)a.columns * a.rows + 1u) * sizeof(uint32_t)) == 0);
}

/* Nearest point by brute force; the lowest index among equally near points. */
static void neighbours_are_those_of_a_search_of_all(const scene *of, double x, double y, uint64_t *seed)
{
    for (int k = 0; k < 6; k++) {
        const ek_real at[] = {EK_R(x) + place(seed, of->width, of->grid / 2.0), EK_R(y) + place(seed, of->height, 0.0)};
        const ek_real limit = k % 2 ? EK_R(0.3) : EK_R(1e9), radius = uniform(seed, 0.001, 1.0);
        const ek_neighbour found = ek_index_nearest(&updated, at[0], at[1], limit, radius);
        const ek_neighbour twin = ek_index_nearest(&built, at[0], at[1], limit, radius);
        ek_real least = EK_FAR * EK_FAR;
        size_t nearest = MAX_COUNT;
        for (size_t i = 0; i < held; i++) {
            const ek_real dx = cloud[2u * i] - at[0], dy = cloud[2u * i + 1u] - at[1], squared = dx * dx + dy * dy;
            nearest = squared < least ? i : nearest;
            least = squared < least ? squared : least;
        }
        CHECK(found.slot == twin.slot && memcmp(&found.others, &twin.others, sizeof found.others) == 0);
        CHECK((found.slot != EK_NONE) == (held && EK_SQRT(least) < limit));
        CHECK(found.slot == EK_NONE || updated.id[found.slot] == nearest);
    }
}

/* Remove and append points at random; returns how often other cells were chosen. */
static int changes_are_to_the_bit_what_building_gives(const scene *of, uint64_t *seed)
{
    size_t sizes[STEPS], oldest = 0;
    int others = 0;
    double x = 0.0, y = 0.0;
    held = 0u;
    CHECK(ek_index_build(&updated, cloud, 0u) == EK_OK && ek_index_build(&built, cloud, 0u) == EK_OK);
    for (size_t step = 0; step < STEPS; step++, x += of->step, y -= of->step / 2.0) {
        size_t removed = 0u;
        sizes[step] = below(seed, 8u) ? below(seed, of->points + 1u) : 0u;
        while (held - removed + sizes[step] > MAX_COUNT || (oldest < step && below(seed, 12u) == 0u)) {
            removed += sizes[oldest++];
        }
        memmove(cloud, cloud + 2u * removed, 2u * (held - removed) * sizeof(ek_real));
        held -= removed;
        const ek_real *const added = cloud + 2u * held;
        for (size_t i = 0; i < sizes[step]; i++, held++) {
            cloud[2u * held] = EK_R(x) + place(seed, of->width, of->grid);
            cloud[2u * held + 1u] = EK_R(y) + (i % 2u ? place(seed, of->height, of->grid) : EK_R(0.0));
        }
        const ek_cell_grid before = updated.cells;
        CHECK(ek_index_update(&merge, &updated, removed, added, sizes[step]) == EK_OK);
        CHECK(ek_index_build(&built, cloud, held) == EK_OK);
        others += before.left < updated.cells.left || before.left > updated.cells.left ||
                  before.cell < updated.cells.cell || before.cell > updated.cells.cell;
        are_equal();
        neighbours_are_those_of_a_search_of_all(of, x, y, seed);
    }
    return others;
}

/* Where the oldest points alone lie along one side of the grid, removing them leaves that side empty: the index is built
 * again with other cells, as from the points that stay. */
static void an_emptied_side_takes_its_cells_away(void)
{
    uint64_t own = 3u, *const seed = &own;
    for (int side = 0; side < 4; side++) {
        ek_real *const old = cloud, *const stay = cloud + 2u * 40u;
        for (size_t i = 0; i < 440u; i++) { /* 40 points in the first tenth of one axis, the others in its far half */
            const double along = i < 40u ? (double)uniform(seed, 0.0, 1.0) : (double)uniform(seed, 5.0, 10.0);
            const double across = (double)uniform(seed, 0.0, 10.0), at = side % 2 ? 10.0 - along : along;
            cloud[2u * i] = EK_R(side < 2 ? at : across);
            cloud[2u * i + 1u] = EK_R(side < 2 ? across : at);
        }
        CHECK(ek_index_build(&updated, old, 440u) == EK_OK);
        const ek_cell_grid before = updated.cells;
        CHECK(ek_index_update(&merge, &updated, 40u, NULL, 0u) == EK_OK);
        held = 400u;
        built.cells = before;
        CHECK(ek_index_build(&built, stay, held) == EK_OK);
        are_equal();
    }
}

static void bad_input_is_named_and_changes_nothing(void)
{
    ek_real three[6] = {EK_R(0.0)};
    CHECK(ek_index_update(&merge, &updated, held + 1u, three, 0u) == EK_OUT_OF_RANGE);
    CHECK(ek_index_update(&merge, &updated, held - 1u, cloud, MAX_COUNT) == EK_TOO_MANY_POINTS);
    CHECK(ek_index_update(&merge, &updated, 0u, NULL, 1u) == EK_NULL_POINTER);
    three[5] = EK_R(1e7);
    CHECK(ek_index_update(&merge, &updated, held, three, 3u) == EK_OUT_OF_RANGE);
    three[5] = (ek_real)NAN;
    CHECK(ek_index_update(&merge, &updated, held, three, 3u) == EK_NOT_FINITE);
    updated.capacity--;
    CHECK(ek_index_update(&merge, &updated, 0u, three, 1u) == EK_OUT_OF_RANGE);
    updated.capacity++;
    ek_arena none = ek_arena_make(NULL, 0u);
    ek_index_updater unused;
    CHECK(ek_index_updater_init(&unused, &none, 0u) == EK_OUT_OF_RANGE);
}

static int with(const scene *of, uint64_t *seed)
{
    ek_arena measured = ek_arena_make(NULL, 0u);
    ek_arena *arena = &measured, taken = measured;
    for (int pass = 0; pass < 2; pass++) {
        CHECK(ek_index_init(&updated, arena, MAX_COUNT, of->cells) == EK_OK);
        CHECK(ek_index_updater_init(&merge, arena, MAX_COUNT) == EK_OK);
        CHECK(ek_index_init(&built, arena, MAX_COUNT, of->cells) == EK_OK);
        if (pass == 0) {
            taken = memory_of(measured.used);
            arena = &taken;
        }
    }
    CHECK(ek_arena_check(arena) == EK_OK);
    const int others = changes_are_to_the_bit_what_building_gives(of, seed);
    if (of->cells >= 4000u) {
        an_emptied_side_takes_its_cells_away();
    }
    bad_input_is_named_and_changes_nothing();
    free(taken.memory);
    return others;
}

int main(void)
{
    static const scene room = {6.0, 4.0, 0.0, 0.0, 120u, 6000u}, drive = {6.0, 4.0, 0.4, 0.0, 120u, 6000u};
    static const scene small_board = {6.0, 4.0, 0.02, 0.0, 120u, 60u}, ties = {2.0, 1.5, 0.01, 0.125, 120u, 6000u};
    static const scene far_apart = {9e5, 5e5, 0.0, 0.0, 40u, 4000u}, line = {5.0, 0.0, 0.1, 0.0, 300u, 2000u};
    static const scene one_place = {1e-4, 1e-4, 0.0, 0.0, 200u, 50u}, few = {3.0, 3.0, 0.3, 0.5, 3u, 9u};
    static const scene *const all[] = {&drive, &small_board, &ties, &far_apart, &line, &one_place, &few, &room};
    uint64_t seed = 11u;
    int others = 0;
    for (size_t k = 0; k < sizeof all / sizeof *all; k++) {
        others = with(all[k], &seed);
    }
    CHECK(others < 5); /* in a room it is rarely built again */
    return verdict();
}

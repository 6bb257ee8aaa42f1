#include "check.h"
#include "ek/icp.h"
#include "ek/normals.h"
#include "ek/table.h"

#define POINTS 1500u
#define PLACES 500u

static ek_real cloud[2u * POINTS], place_x[PLACES], place_y[PLACES];
static ek_index kept, plain;
static ek_table table;

static void fill(uint64_t *seed)
{
    for (size_t k = 0; k < POINTS; k++) { /* half on a wall, half anywhere, some twice, one far away */
        cloud[2u * k] = uniform(seed, 0.0, 10.0);
        cloud[2u * k + 1u] = k % 2u ? uniform(seed, -0.05, 0.05) : uniform(seed, 0.0, 5.0);
    }
    memcpy(cloud + 200, cloud + 100, 40u * sizeof(ek_real));
    for (size_t k = 150; k < 250u; k++) { /* more in one place than a block is chosen from */
        cloud[2u * k] = EK_R(3.0);
        cloud[2u * k + 1u] = EK_R(2.0);
    }
    cloud[20] = EK_R(-40.0);
}

/* The points outside a block are not nearer to its centre than it says. */
static void bounds_the_others(const ek_block *block, size_t count)
{
    for (uint32_t slot = 0; slot < count; slot++) {
        int inside = 0;
        for (size_t k = 0; k < EK_BLOCK; k++) {
            inside |= block->slot[k] == slot && block->x[k] < EK_FAR;
        }
        const ek_real dx = kept.xy[2u * slot] - block->centre_x, dy = kept.xy[2u * slot + 1u] - block->centre_y;
        CHECK(inside || block->others <= EK_SQRT(dx * dx + dy * dy) + kept.cells.margin);
    }
}

/* The nearest point of a block, of equals the first, is what the index finds. */
static void finds_the_same(const ek_block *block, ek_real x, ek_real y, ek_real limit)
{
    const ek_neighbour expected = ek_index_nearest(&plain, x, y, limit, EK_R(0.2));
    ek_real best = EK_FAR;
    uint32_t slot = EK_NONE;
    for (size_t k = 0; k < EK_BLOCK; k++) {
        const ek_real dx = block->x[k] - x, dy = block->y[k] - y, distance = EK_SQRT(dx * dx + dy * dy);
        slot = distance < best ? block->slot[k] : slot;
        best = distance < best ? distance : best;
    }
    CHECK(expected.slot == EK_NONE ? best >= limit : slot == expected.slot && best == expected.distance);
}

/* Ask for the same places again and again: before, while and after their blocks are made. Returns the blocks found. */
static size_t finds_what_the_index_finds(size_t count, double limit, uint64_t *seed)
{
    static uint32_t which[PLACES], at[PLACES];
    size_t found = 0u;
    CHECK(ek_index_build(&kept, cloud, count) == EK_OK && ek_index_build(&plain, cloud, count) == EK_OK);
    ek_table_attach(&table, &kept);
    for (uint32_t k = 0; k < PLACES; k++) {
        which[k] = (k * 7u) % PLACES;
        place_x[k] = k % 10u ? uniform(seed, -0.5, 10.5) : uniform(seed, -60.0, 60.0);
        place_y[k] = k % 3u ? uniform(seed, -0.1, 0.1) : uniform(seed, -1.0, 6.0);
        if (k % 5u == 0u) { /* exactly on a point: some are equally near */
            place_x[k] = cloud[2u * (100u + k / 5u) % (2u * count)];
            place_y[k] = cloud[(2u * (100u + k / 5u) + 1u) % (2u * count)];
        }
    }
    for (int turn = 0; turn < 6; turn++) {
        const ek_real now = EK_R(turn < 5 ? limit : 2.0 * limit);
        ek_table_locate(&table, &kept, place_x, place_y, which, PLACES, at);
        for (size_t k = 0; k < PLACES; k++) {
            const ek_real x = place_x[which[k]], y = place_y[which[k]];
            const ek_block *const block = ek_table_block(&table, &kept, at[k], x, y, now);
            CHECK(!block || at[k]);
            if (block) {
                found++;
                finds_the_same(block, x, y, now);
                bounds_the_others(block, count);
            }
        }
    }
    return found;
}

static void the_table_is_used(size_t found)
{
    CHECK(found > 3u * PLACES / 2u);
    CHECK(table.blocks > 100u && table.tiles > 100u);
    size_t partial = 0u, empty = 0u;
    for (size_t k = 1; k < table.blocks; k++) {
        partial += table.block[k].complete ? 0u : 1u;
        empty += table.block[k].x[0] == EK_FAR;
    }
    CHECK(partial > 0u && empty > 0u);
}

static void a_registration_is_the_same_to_the_bit(uint64_t *seed)
{
    static ek_real source[2u * PLACES];
    static ek_real normals[2u * POINTS], deferred[2u * POINTS];
    static ek_icp icp;
    ek_icp_parameters parameters = ek_icp_default();
    ek_arena arena = memory_of(400000u);
    CHECK(ek_icp_init(&icp, &arena, PLACES, POINTS) == EK_OK && ek_icp_init_table(&icp, &arena) == EK_OK);
    CHECK(ek_icp_init_lines(&icp, &arena) == EK_OK && ek_arena_check(&arena) == EK_OK);
    CHECK(ek_index_build(&kept, cloud, POINTS) == EK_OK && ek_index_build(&plain, cloud, POINTS) == EK_OK);
    for (size_t k = 0; k < 2u * PLACES; k++) {
        source[k] = cloud[k] + uniform(seed, -0.02, 0.02);
    }
    parameters.epsilon = EK_R(0.0);
    CHECK(ek_normals_compute(&plain, 8u, EK_FAR, normals) == EK_OK && ek_normals_defer(&kept, 8u, deferred) == EK_OK);
    plain.normals = normals;
    for (int turn = 0; turn < 12; turn++) {
        const ek_pose guess = {uniform(seed, -0.1, 0.1), uniform(seed, -0.1, 0.1), uniform(seed, -0.03, 0.03)};
        ek_match with, without;
        parameters.one_to_one = turn % 2;
        parameters.error_before = turn % 3 == 0;
        parameters.metric = turn % 4 < 2 ? EK_METRIC_POINT : EK_METRIC_LINE;
        parameters.share_noise = turn % 4 == 3;
        CHECK(ek_icp_register(&icp, &kept, source, PLACES, guess, &parameters, NULL, NULL, &with) == EK_OK);
        CHECK(ek_icp_register(&icp, &plain, source, PLACES, guess, &parameters, NULL, NULL, &without) == EK_OK);
        CHECK(memcmp(&with.target_from_source, &without.target_from_source, sizeof(ek_pose)) == 0);
        CHECK(with.error == without.error && with.inliers == without.inliers && with.inliers > 100);
        CHECK(with.iterations == without.iterations && with.converged == without.converged);
    }
    free(arena.memory);
}

/* A pair is nearer than the limit, to the last bit: with a table squares are compared. Below the square root of the
 * smallest number, too, where a square is rounded to 0. */
static void the_limit_is_exact(uint64_t *seed)
{
    static ek_icp icp;
    const ek_pose identity = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    const ek_real target[] = {EK_R(0.0), EK_R(0.0), EK_R(100.0), EK_R(100.0)};
    ek_icp_parameters parameters = ek_icp_default();
    ek_match match;
    ek_arena arena = memory_of(200000u);
    CHECK(ek_icp_init(&icp, &arena, 10u, POINTS) == EK_OK && ek_icp_init_table(&icp, &arena) == EK_OK);
    CHECK(ek_arena_check(&arena) == EK_OK && ek_index_build(&kept, target, 2u) == EK_OK);
    parameters.one_to_one = 0;
    for (int k = 0; k < 200; k++) {
        const ek_real limit = k ? uniform(seed, 0.1, 1.0) : EK_R(1e-35), below = limit * (EK_R(1.0) - EK_EPSILON);
        const ek_real source[] = {limit, EK_R(0.0), below, EK_R(0.0), EK_R(0.0), EK_R(0.0)};
        parameters.max_correspondence = limit;
        CHECK(ek_icp_register(&icp, &kept, source, 3u, identity, &parameters, NULL, NULL, &match) == EK_OK);
        CHECK(match.inliers == (k || sizeof(ek_real) == 8u ? 2 : 3)); /* squares of 1e-35 are 0 in single precision */
    }
    free(arena.memory);
}

static void bad_input_is_named(void)
{
    ek_arena none = ek_arena_make(NULL, 0u);
    ek_table other;
    CHECK(ek_table_init(&other, &none, &plain, 0u, 10u) == EK_OUT_OF_RANGE);
    CHECK(ek_table_init(&other, &none, &plain, 10u, (size_t)1 << 27) == EK_OUT_OF_RANGE);
    CHECK(ek_table_init(&other, &none, NULL, 10u, 10u) == EK_NULL_POINTER);
    CHECK(ek_table_init(&other, &none, &plain, 1000u, 1000u) == EK_OK && plain.table == NULL);
    ek_arena little = memory_of(none.used - 16u);
    CHECK(ek_table_init(&other, &little, &plain, 1000u, 1000u) == EK_OK);
    CHECK(ek_arena_check(&little) == EK_TOO_LITTLE_MEMORY && little.used == none.used && plain.table == NULL);
    free(little.memory);
}

int main(void)
{
    uint64_t seed = 3u;
    const size_t sizes[][2] = {{4000u, 20000u}, {4000u, 20u}, {20u, 20000u}};
    fill(&seed);
    for (size_t k = 0; k < 3u; k++) {
        ek_arena arena = memory_of(4000000u);
        CHECK(ek_index_init(&kept, &arena, POINTS, 4000u) == EK_OK && ek_index_init(&plain, &arena, POINTS, 4000u) == EK_OK);
        CHECK(ek_table_init(&table, &arena, &kept, sizes[k][0], sizes[k][1]) == EK_OK);
        CHECK(ek_arena_check(&arena) == EK_OK && kept.table == &table);
        (void)finds_what_the_index_finds(POINTS, 0.3, &seed);
        (void)finds_what_the_index_finds(POINTS, 1e9, &seed);
        const size_t found = finds_what_the_index_finds(POINTS, 0.05, &seed);
        if (k == 0u) {
            the_table_is_used(found);
        }
        (void)finds_what_the_index_finds(2u, 1.0, &seed);
        (void)finds_what_the_index_finds(1u, 1e9, &seed);
        a_registration_is_the_same_to_the_bit(&seed);
        the_limit_is_exact(&seed);
        free(arena.memory);
    }
    bad_input_is_named();
    return verdict();
}

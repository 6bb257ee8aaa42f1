/* The copies of the loops give the same bits: `test_copies 1` compares those for AVX2 with those for every processor, 2 those
 * for AVX-512. Where the processor lacks it: SKIPPED. */
#include "check.h"
#include "ek/fit.h"
#include "ek/icp.h"
#include "ek/nearby.h"
#include "ek/normals.h"
#include "ek/table.h"
#include "ek/wide.h"

#define SKIPPED 77
#define TARGETS 3000u
#define SOURCES 203u /* no multiple of the lanes */
#define COUNT 40u

static ek_real cloud[2u * TARGETS], source[2u * SOURCES], normals[2][2u * TARGETS];

/* Pairs in general position with fractions as weights. */
static void fits_are_the_same(int wide, uint64_t *seed)
{
    static ek_real numbers[8][COUNT];
    ek_pose points[2], lines[2];
    ek_real sums[2][3];
    for (size_t k = 0; k < 8u * COUNT; k++) {
        numbers[k / COUNT][k % COUNT] = uniform(seed, k < 6u * COUNT ? -3.0 : 0.0, k < 6u * COUNT ? 3.0 : 1.0);
    }
    for (int copy = 0; copy < 2; copy++) {
        const int now = copy ? wide : 0;
        const ek_pairs pairs = {COUNT,      numbers[0], numbers[1], numbers[2], numbers[3],
                                numbers[4], numbers[5], numbers[6], numbers[7], now};
        points[copy] = ek_fit_points(&pairs, EK_R(1.0), EK_R(2.0));
        lines[copy] = ek_fit_lines(&pairs, EK_R(0.1), EK_R(1.0), EK_R(2.0));
        sums[copy][0] = ek_fit_count(numbers[6], COUNT, now);
        sums[copy][1] = ek_fit_sum(numbers[6], numbers[0], COUNT, 0, now);
        sums[copy][2] = ek_fit_sum(numbers[6], numbers[0], COUNT, 1, now);
    }
    CHECK(memcmp(points, points + 1, sizeof *points) == 0 && memcmp(lines, lines + 1, sizeof *lines) == 0);
    CHECK(memcmp(sums[0], sums[1], sizeof *sums) == 0);
}

/* The cells of clouds of any size, and what is refused at any place of a cloud. */
static void clouds_are_indexed_the_same(int wide, uint64_t *seed)
{
    const ek_real faults[] = {(ek_real)NAN, (ek_real)INFINITY, -EK_R(2.0) * EK_MAX_COORDINATE, EK_R(2.0) * EK_MAX_COORDINATE};
    ek_arena arena = memory_of(6000000u);
    ek_index one[2];
    for (int copy = 0; copy < 2; copy++) {
        CHECK(ek_index_init(one + copy, &arena, TARGETS, 40000u) == EK_OK);
        one[copy].wide = copy ? wide : 0;
    }
    for (uint32_t count = 1u; count <= TARGETS; count += count < 40u ? 1u : 740u) {
        const size_t at = (size_t)uniform(seed, 0.0, 2.0 * (double)count - 0.5);
        const ek_real kept = cloud[at];
        for (int copy = 0; copy < 2; copy++) {
            cloud[at] = faults[count % 4u];
            CHECK(ek_index_build(one + copy, cloud, count) == (count % 4u < 2u ? EK_NOT_FINITE : EK_OUT_OF_RANGE));
            cloud[at] = kept;
            CHECK(ek_index_build(one + copy, cloud, count) == EK_OK && one[copy].count == count);
        }
        const size_t cells = (size_t)one[0].cells.columns * one[0].cells.rows;
        CHECK(memcmp(&one[0].cells, &one[1].cells, sizeof one[0].cells) == 0 && one[0].start[cells] == count);
        CHECK(memcmp(one[0].start, one[1].start, (cells + 1u) * sizeof *one[0].start) == 0);
        CHECK(memcmp(one[0].xy, one[1].xy, 2u * count * sizeof *one[0].xy) == 0);
        CHECK(memcmp(one[0].id, one[1].id, count * sizeof *one[0].id) == 0);
    }
    free(arena.memory);
}

/* Places of a raster, on which some target points are equally near, and others; every eighth in the gap around (0, 0), where
 * lanes without a point would lie. */
static ek_real draw_place(uint32_t turn, uint64_t *seed, double low, double high)
{
    const ek_real place = uniform(seed, turn % 8u ? low : -0.1, turn % 8u ? high : 0.1);
    return turn % 4u == 1u ? EK_R(0.0625) * EK_FLOOR(EK_R(16.0) * place) : place;
}

static void searches_are_the_same(ek_index *index, int wide, uint64_t *seed)
{
    uint32_t found = 0u;
    for (uint32_t turn = 0; turn < 4000u; turn++) {
        const ek_real x = draw_place(turn, seed, -6.0, 6.0), y = draw_place(turn, seed, -2.0, 8.0);
        const ek_real radius = uniform(seed, 0.01, 1.0);
        ek_neighbour answer[2];
        for (int copy = 0; copy < 2; copy++) {
            index->wide = copy ? wide : 0;
            answer[copy] = ek_index_nearest(index, x, y, EK_R(0.3), radius);
        }
        CHECK(answer[0].slot == answer[1].slot && answer[0].others == answer[1].others);
        CHECK(answer[0].slot == EK_NONE || answer[0].distance == answer[1].distance);
        found += answer[0].slot != EK_NONE;
    }
    CHECK(found > 1000u && found < 3900u);
}

static void searches_in_groups_are_the_same(const ek_index *index, int wide, uint64_t *seed)
{
    uint32_t found = 0u;
    for (uint32_t turn = 0; turn < 2000u; turn++) {
        const ek_real from_x = draw_place(turn, seed, -6.0, 6.0), from_y = draw_place(turn, seed, -2.0, 8.0);
        const ek_real radius = uniform(seed, 0.01, 0.4);
        ek_real x[EK_GROUP], y[EK_GROUP];
        ek_nearby nearby[2];
        for (uint32_t lane = 0; lane < EK_GROUP; lane++) {
            x[lane] = from_x + uniform(seed, -0.1, 0.1);
            y[lane] = from_y + uniform(seed, -0.1, 0.1);
        }
        memset(nearby, 0, sizeof nearby);
        const int near = ek_index_nearby(index, x, y, radius, 0, nearby);
        CHECK(near == ek_index_nearby(index, x, y, radius, wide, nearby + 1));
        CHECK(!near || memcmp(nearby, nearby + 1, sizeof *nearby) == 0);
        found += near ? 1u : 0u;
    }
    CHECK(found > 1000u);
}

/* More points in one cell than there are lanes, and a place that is nan, are no place for a neighbour. */
static void nothing_is_near_what_is_no_place(int wide)
{
    ek_real points[2u * 40u];
    ek_index index;
    ek_arena arena = memory_of(8000u);
    for (size_t k = 0; k < 2u * 40u; k++) {
        points[k] = EK_R(1.0);
    }
    CHECK(ek_index_init(&index, &arena, 40u, 16u) == EK_OK && ek_index_build(&index, points, 40u) == EK_OK);
    for (int copy = 0; copy < 2; copy++) {
        index.wide = copy ? wide : 0;
        CHECK(ek_index_nearest(&index, (ek_real)NAN, EK_R(1.0), EK_R(0.3), EK_R(0.1)).slot == EK_NONE);
        CHECK(ek_index_nearest(&index, EK_R(1.0), EK_R(1.1), EK_R(0.3), EK_R(0.1)).slot == 0u);
    }
    free(arena.memory);
}

static void normals_are_the_same(ek_index *index, int wide)
{
    for (int copy = 0; copy < 2; copy++) {
        index->wide = copy ? wide : 0;
        CHECK(ek_normals_compute(index, 8u, EK_FAR, normals[copy]) == EK_OK);
    }
    CHECK(memcmp(normals[0], normals[1], sizeof *normals) == 0);
}

/* Points and lines, with and without a table, one-to-one and not; every fourth source point lies on a target point, and some
 * target points are equally near. */
static void registrations_are_the_same(ek_index *index, ek_icp *icp, int wide, uint64_t *seed)
{
    ek_icp_parameters parameters = ek_icp_default();
    parameters.epsilon = EK_R(1e-9);
    for (uint32_t turn = 0; turn < 32u; turn++) {
        const ek_pose guess = {uniform(seed, -0.1, 0.1), uniform(seed, -0.1, 0.1), uniform(seed, -0.03, 0.03)};
        ek_match match[2];
        parameters.one_to_one = turn & 1u ? 1 : 0;
        parameters.error_before = turn & 2u ? 1 : 0;
        parameters.metric = turn & 4u ? EK_METRIC_LINE : EK_METRIC_POINT;
        parameters.share_noise = turn & 8u ? 1 : 0;
        parameters.error = turn & 16u ? EK_ERROR_RMSE : EK_ERROR_MEAN;
        index->normals = normals[0];
        for (int copy = 0; copy < 2; copy++) {
            icp->wide = copy ? wide : 0;
            CHECK(ek_icp_register(icp, index, source, SOURCES, guess, &parameters, NULL, NULL, match + copy) == EK_OK);
        }
        CHECK(memcmp(&match[0].target_from_source, &match[1].target_from_source, sizeof(ek_pose)) == 0);
        CHECK(match[0].error == match[1].error && match[0].inliers == match[1].inliers && match[0].inliers > 50);
        CHECK(match[0].iterations == match[1].iterations && match[0].iterations > 1);
        CHECK(index->table || match[0].queries == match[1].queries); /* a table is fuller the second time */
    }
}

static void compare(int wide)
{
    static ek_index index;
    static ek_icp icp;
    static ek_table table;
    uint64_t seed = 9u;
    ek_arena arena = memory_of(6000000u);
    for (size_t k = 0; k < TARGETS; k++) { /* a wall, and what stands around with a gap at (0, 0); some in a raster */
        cloud[2u * k] = uniform(&seed, -5.0, 5.0);
        cloud[2u * k + 1u] = k % 3u ? uniform(&seed, 0.9, 1.1) : uniform(&seed, 0.0, 7.0);
        if (cloud[2u * k + 1u] < EK_R(0.25) && EK_FABS(cloud[2u * k]) < EK_R(0.25)) {
            cloud[2u * k + 1u] += EK_R(0.25);
        }
        if (k % 5u == 0u) {
            cloud[2u * k] = EK_R(0.125) * EK_FLOOR(EK_R(8.0) * cloud[2u * k]);
            cloud[2u * k + 1u] = EK_R(0.125) * EK_FLOOR(EK_R(8.0) * cloud[2u * k + 1u]);
        }
    }
    for (size_t k = 0; k < 2u * SOURCES; k++) {
        source[k] = cloud[k] + (k % 8u < 2u ? EK_R(0.0) : uniform(&seed, -0.02, 0.02));
    }
    CHECK(ek_index_init(&index, &arena, TARGETS, 40000u) == EK_OK && ek_icp_init(&icp, &arena, SOURCES, TARGETS) == EK_OK);
    CHECK(ek_icp_init_table(&icp, &arena) == EK_OK && ek_icp_init_lines(&icp, &arena) == EK_OK);
    CHECK(ek_table_init(&table, &arena, &index, 4000u, 10000u) == EK_OK && ek_arena_check(&arena) == EK_OK);
    CHECK(icp.wide == ek_wide() && index.wide == ek_wide());
    CHECK(ek_index_build(&index, cloud, TARGETS) == EK_OK);
    fits_are_the_same(wide, &seed);
    clouds_are_indexed_the_same(wide, &seed);
    searches_are_the_same(&index, wide, &seed);
    searches_in_groups_are_the_same(&index, wide, &seed);
    nothing_is_near_what_is_no_place(wide);
    normals_are_the_same(&index, wide);
    for (size_t k = 0; k < 3u; k++) { /* at last by searches of single places */
        index.table = k == 0u ? &table : NULL;
        icp.grouped = k < 2u;
        registrations_are_the_same(&index, &icp, wide, &seed);
    }
    CHECK(table.blocks > 100u);
    free(arena.memory);
}

int main(int count, char **arguments)
{
    const int wide = count == 2 ? atoi(arguments[1]) : 0;
    if (wide < EK_AVX2 || wide > EK_AVX512) {
        fprintf(stderr, "test_copies: expected 1 (AVX2) or 2 (AVX-512)\n");
        return EXIT_FAILURE;
    }
    if (ek_wide() < wide) {
        printf("skipped: this processor or compiler has no %s\n", wide == EK_AVX2 ? "AVX2" : "AVX-512");
        return SKIPPED;
    }
    compare(wide);
    return verdict();
}

#include "check.h"
#include "ek/normals.h"

#define POINTS 1200u

static ek_real cloud[2u * POINTS], normals[2u * POINTS];
static ek_index reference;

/* Normal of point i from a sort of all points by distance and index. */
static void normal_by_sorting(size_t count, size_t i, size_t neighbours, double normal[2])
{
    static int taken[POINTS];
    static size_t near[POINTS];
    double mean[2] = {0.0, 0.0}, difference = 0.0, product = 0.0;
    memset(taken, 0, sizeof taken);
    neighbours = neighbours < count ? neighbours : count;
    for (size_t n = 0; n < neighbours; n++) {
        ek_real least = EK_FAR * EK_FAR;
        for (size_t k = 0; k < count; k++) {
            const ek_real dx = cloud[2u * k] - cloud[2u * i], dy = cloud[2u * k + 1u] - cloud[2u * i + 1u];
            if (!taken[k] && dx * dx + dy * dy < least) {
                least = dx * dx + dy * dy;
                near[n] = k;
            }
        }
        taken[near[n]] = 1;
        mean[0] += (double)cloud[2u * near[n]] / (double)neighbours;
        mean[1] += (double)cloud[2u * near[n] + 1u] / (double)neighbours;
    }
    for (size_t n = 0; n < neighbours; n++) {
        const double u = (double)cloud[2u * near[n]] - mean[0], v = (double)cloud[2u * near[n] + 1u] - mean[1];
        difference += u * u - v * v;
        product += 2.0 * u * v;
    }
    const double along = 0.5 * atan2(product, difference);
    normal[0] = -sin(along);
    normal[1] = cos(along);
}

static void normals_are_those_of_a_sort_of_all_points(size_t count, size_t neighbours)
{
    CHECK(ek_index_build(&reference, cloud, count) == EK_OK);
    CHECK(ek_normals_compute(&reference, neighbours, EK_FAR, normals) == EK_OK);
    for (size_t i = 0; i < count; i++) {
        double expected[2];
        normal_by_sorting(count, i, neighbours, expected);
        const double sine = (double)normals[2u * i] * expected[1] - (double)normals[2u * i + 1u] * expected[0];
        CHECK_NEAR(sine, 0.0, 100.0 * TOLERANCE);
        CHECK_NEAR(normals[2u * i] * normals[2u * i] + normals[2u * i + 1u] * normals[2u * i + 1u], 1.0, TOLERANCE);
        CHECK(normals[2u * i + 1u] >= EK_R(0.0));
    }
}

static void normals_of(const ek_real *xy, size_t count, size_t neighbours)
{
    CHECK(ek_index_build(&reference, xy, count) == EK_OK);
    CHECK(ek_normals_compute(&reference, neighbours, EK_FAR, normals) == EK_OK);
}

static void a_line_has_the_normal_across_it(void)
{
    const ek_real lines[4][4] = {{0, 0, 2, 0}, {0, 0, 0, 2}, {0, 0, 2, 2}, {0, 0, 2, -2}};
    const double half = sqrt(0.5), expected[4][2] = {{0, 1}, {-1, 0}, {-half, half}, {half, half}};
    for (size_t k = 0; k < 4u; k++) {
        normals_of(lines[k], 2u, 8u);
        for (size_t i = 0; i < 2u; i++) {
            CHECK_NEAR(normals[2u * i], expected[k][0], TOLERANCE);
            CHECK_NEAR(normals[2u * i + 1u], expected[k][1], TOLERANCE);
        }
    }
}

static void without_a_direction_the_normal_is_y(void)
{
    const ek_real square[] = {1, 1, -1, 1, -1, -1, 1, -1}, same[] = {3, 4, 3, 4, 3, 4, 9, 9};
    normals_of(square, 4u, 4u);
    CHECK(normals[0] == EK_R(0.0) && normals[1] == EK_R(1.0));
    normals_of(square, 1u, 2u);
    CHECK(normals[0] == EK_R(0.0) && normals[1] == EK_R(1.0));
    normals_of(same, 4u, 3u);
    CHECK(normals[0] == EK_R(0.0) && normals[1] == EK_R(1.0));
    normals_of(same, 0u, 3u);
}

/* However near they are: squares of squares of metres are below the smallest numbers that have all digits. */
static void normals_of_points_that_hardly_differ_have_length_1(void)
{
    ek_real s = EK_R(1.0);
    for (int k = 0; k < 1200; k++, s *= EK_R(0.7)) {
        const ek_real near[] = {0, 0, s, EK_R(2.0) * s, EK_R(3.0) * s, EK_R(4.0) * s};
        normals_of(near, 3u, 3u);
        CHECK_NEAR(sqrt((double)(normals[0] * normals[0] + normals[1] * normals[1])), 1.0, 1e-6);
    }
}

static void points_beyond_the_radius_are_no_neighbours(void)
{
    const ek_real wall[] = {0, 0, 1, 0, 2, 0, 1, 5, 3, 4, 3, 4, 3, 4};
    CHECK(ek_index_build(&reference, wall, 7u) == EK_OK);
    CHECK(ek_normals_compute(&reference, 4u, EK_R(1.5), normals) == EK_OK);
    CHECK(normals[2] == EK_R(0.0) && normals[3] == EK_R(1.0)); /* three on a wall, the others too far */
    for (size_t k = 0; k < 7u; k++) {
        CHECK(k == 1u || (normals[2u * k] == EK_R(0.0) && normals[2u * k + 1u] == EK_R(0.0)));
    }
    const ek_real least = EK_R(sizeof(ek_real) == sizeof(float) ? 1e-30 : 1e-200); /* its square is zero */
    CHECK(ek_normals_compute(&reference, 4u, least, normals) == EK_OK);
    CHECK(normals[2] >= EK_R(0.0) && normals[2] <= EK_R(0.0) && normals[3] >= EK_R(0.0) && normals[3] <= EK_R(0.0));
    CHECK(ek_normals_compute(&reference, 4u, EK_R(0.0), normals) == EK_OUT_OF_RANGE);
}

static void deferred_normals_are_the_same_to_the_bit(void)
{
    static ek_real later[2u * POINTS];
    CHECK(ek_index_build(&reference, cloud, POINTS) == EK_OK);
    CHECK(ek_normals_compute(&reference, 8u, EK_FAR, normals) == EK_OK);
    CHECK(ek_normals_defer(&reference, 8u, later) == EK_OK && reference.normals == later);
    ek_real first = EK_R(0.001); /* the width of the first search changes nothing */
    for (uint32_t slot = POINTS; slot-- > 0u;) {
        ek_normals_ensure(&reference, slot, &first);
        ek_normals_ensure(&reference, slot, &first);
    }
    CHECK(memcmp(normals, later, sizeof later) == 0);
    CHECK(ek_normals_defer(&reference, 1u, later) == EK_OUT_OF_RANGE);
    CHECK(ek_index_build(&reference, cloud, 5u) == EK_OK && reference.deferred == NULL);
}

static void a_mean_of_n_points_counts_as_n_in_a_noisy_index(void)
{
    const ek_real points[] = {0, 0, 1, 0, 1, 1}, again[] = {0, 0, 1, 0, 1, 1, 1, 1, 1, 1};
    const uint32_t support[] = {1u, 1u, 3u};
    ek_real expected[2], equal[2];
    uint32_t many[] = {1u, 1u, EK_MAX_SUPPORT};
    normals_of(again, 5u, 5u);
    memcpy(expected, normals, sizeof expected);
    normals_of(points, 3u, 3u);
    CHECK(EK_FABS(normals[0] - expected[0]) > EK_R(0.05));
    memcpy(equal, normals, sizeof equal);
    reference.support = support;
    CHECK(ek_normals_compute(&reference, 3u, EK_FAR, normals) == EK_OK && memcmp(equal, normals, sizeof equal) == 0);
    reference.noisy = 1;
    CHECK(ek_normals_compute(&reference, 3u, EK_FAR, normals) == EK_OK);
    CHECK_NEAR(normals[0], expected[0], TOLERANCE);
    CHECK_NEAR(normals[1], expected[1], TOLERANCE);
    reference.support = many;
    CHECK(ek_normals_compute(&reference, 3u, EK_FAR, normals) == EK_OK);
    memcpy(expected, normals, sizeof expected);
    many[2] = 1000u; /* no more than EK_MAX_SUPPORT count */
    CHECK(ek_normals_compute(&reference, 3u, EK_FAR, normals) == EK_OK && memcmp(expected, normals, sizeof expected) == 0);
}

static void bad_input_is_named(void)
{
    CHECK(ek_normals_compute(&reference, 1u, EK_FAR, normals) == EK_OUT_OF_RANGE);
    CHECK(ek_normals_compute(&reference, EK_MAX_NEIGHBOURS + 1u, EK_FAR, normals) == EK_OUT_OF_RANGE);
    CHECK(ek_normals_compute(NULL, 8u, EK_FAR, normals) == EK_NULL_POINTER);
    CHECK(ek_index_build(&reference, cloud, 3u) == EK_OK);
    CHECK(ek_normals_compute(&reference, 8u, EK_FAR, NULL) == EK_NULL_POINTER);
}

int main(void)
{
    uint64_t seed = 11u;
    ek_arena arena = memory_of(200000u);
    CHECK(ek_index_init(&reference, &arena, POINTS, 4000u) == EK_OK && ek_arena_check(&arena) == EK_OK);
    for (size_t k = 0; k < POINTS; k++) { /* on two walls and anywhere, one far away */
        cloud[2u * k] = k % 3u == 1u ? uniform(&seed, -0.05, 0.05) : uniform(&seed, 0.0, 10.0);
        cloud[2u * k + 1u] = k % 3u == 0u ? uniform(&seed, -0.05, 0.05) : uniform(&seed, 0.0, 5.0);
    }
    cloud[20] = EK_R(-40.0);
    normals_are_those_of_a_sort_of_all_points(POINTS, 8u);
    normals_are_those_of_a_sort_of_all_points(POINTS, EK_MAX_NEIGHBOURS);
    normals_are_those_of_a_sort_of_all_points(50u, EK_MAX_NEIGHBOURS);
    normals_are_those_of_a_sort_of_all_points(POINTS, 3u);
    a_line_has_the_normal_across_it();
    without_a_direction_the_normal_is_y();
    normals_of_points_that_hardly_differ_have_length_1();
    points_beyond_the_radius_are_no_neighbours();
    deferred_normals_are_the_same_to_the_bit();
    a_mean_of_n_points_counts_as_n_in_a_noisy_index();
    bad_input_is_named();
    free(arena.memory);
    return verdict();
}

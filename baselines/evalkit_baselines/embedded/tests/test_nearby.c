#include "check.h"
#include "ek/icp.h"
#include "ek/nearby.h"
#include "ek/normals.h"
#include "ek/wide.h"

#define POINTS 1500u
#define SOURCES 400u

static ek_real cloud[2u * POINTS];
static ek_index index_;

/* Points on a lattice: many are exactly equally near to a place between them. */
static void fill_lattice(void)
{
    for (size_t k = 0; k < POINTS; k++) {
        cloud[2u * k] = EK_R(0.25) * (ek_real)(k % 50u);
        cloud[2u * k + 1u] = EK_R(0.25) * (ek_real)(29u - k / 50u);
    }
}

/* Half on a wall, half anywhere, some twice, one far away. */
static void fill_room(uint64_t *seed)
{
    for (size_t k = 0; k < POINTS; k++) {
        cloud[2u * k] = uniform(seed, 0.0, 10.0);
        cloud[2u * k + 1u] = k % 2u ? uniform(seed, -0.05, 0.05) : uniform(seed, 0.0, 5.0);
    }
    memcpy(cloud + 200, cloud + 100, 40u * sizeof(ek_real));
    cloud[20] = EK_R(-40.0);
}

/* What is found for a place, against all points. Returns 1 if the nearest one is proven. */
static int bounds_hold(const ek_nearby *found, uint32_t lane, ek_real x, ek_real y)
{
    double inside = 1e18, outside = 1e18;
    size_t kept = 0u;
    for (uint32_t slot = 0; slot < index_.count; slot++) {
        const double dx = (double)(index_.xy[2u * slot] - x), dy = (double)(index_.xy[2u * slot + 1u] - y);
        const double distance = sqrt(dx * dx + dy * dy);
        int in = 0;
        for (size_t k = 0; k < EK_BLOCK; k++) {
            in += found->slot[k][lane] == slot;
        }
        CHECK(in < 2);
        kept += in ? 1u : 0u;
        inside = in && distance < inside ? distance : inside;
        outside = !in && distance < outside ? distance : outside;
    }
    CHECK(kept <= EK_BLOCK && (kept == EK_BLOCK || found->slot[kept][lane] == EK_NONE));
    CHECK(kept == 0u || inside <= (double)found->nearest[lane]);
    CHECK(outside >= (double)found->others[lane]);
    const int proven = found->nearest[lane] < found->others[lane];
    CHECK(!proven || inside < outside);
    return proven;
}

/* Groups of places in a row, as the ends of beams; some apart, some outside the cells, some exactly on a point. */
static int all_bounds_hold(uint64_t *seed, ek_real radius)
{
    int proven = 0;
    for (int turn = 0; turn < 200; turn++) {
        const ek_real from_x = uniform(seed, -1.0, 13.0), from_y = uniform(seed, -1.0, 8.0);
        const double step = turn % 5 ? 0.05 : 5.0;
        ek_real x[EK_GROUP], y[EK_GROUP];
        ek_nearby found, plainly;
        for (size_t lane = 0; lane < EK_GROUP; lane++) {
            x[lane] = turn % 7 ? from_x + uniform(seed, -step, step) : cloud[2u * ((size_t)turn + lane)];
            y[lane] = turn % 7 ? from_y + uniform(seed, -step, step) : cloud[2u * ((size_t)turn + lane) + 1u];
        }
        const int near = ek_index_nearby(&index_, x, y, radius, ek_wide(), &found);
        CHECK(near == ek_index_nearby(&index_, x, y, radius, 0, &plainly));
        CHECK(!near || memcmp(&found, &plainly, sizeof found) == 0);
        for (uint32_t lane = 0; near && lane < EK_GROUP; lane++) {
            proven += bounds_hold(&found, lane, x[lane], y[lane]);
        }
    }
    return proven;
}

static void too_many_points_are_not_searched(void)
{
    ek_real x[EK_GROUP] = {EK_R(0.0)}, y[EK_GROUP] = {EK_R(0.0)};
    ek_nearby found;
    CHECK(ek_index_build(&index_, cloud, 257u) == EK_OK && !ek_index_nearby(&index_, x, y, EK_R(1e3), 0, &found));
    CHECK(ek_index_build(&index_, cloud, 256u) == EK_OK && ek_index_nearby(&index_, x, y, EK_R(1e3), 0, &found));
    (void)bounds_hold(&found, 0u, x[0], y[0]);
    CHECK(ek_index_build(&index_, cloud, 3u) == EK_OK && ek_index_nearby(&index_, x, y, EK_R(1e3), 0, &found));
    CHECK(found.slot[2][7] != EK_NONE && found.slot[3][7] == EK_NONE && found.others[7] > EK_R(1e10)); /* there is no other */
    CHECK(ek_index_build(&index_, cloud, 0u) == EK_OK && !ek_index_nearby(&index_, x, y, EK_R(1e3), 0, &found));
}

typedef struct {
    size_t iterations;
    uint32_t pairs[40][2u * SOURCES];
} history;

static void note(void *context, const ek_icp_iteration *now)
{
    history *const h = (history *)context;
    uint32_t *const pairs = h->pairs[h->iterations++];
    memset(pairs, 0, 2u * SOURCES * sizeof *pairs);
    for (int32_t k = 0; k < now->inliers; k++) {
        pairs[2 * k] = now->source[k];
        pairs[2 * k + 1] = now->target[k];
    }
}

/* The same pairs in each iteration and the same pose, whether places are searched one by one or in groups; with fewer
 * searches. */
static void a_registration_is_the_same(uint64_t *seed, int lattice)
{
    static ek_real source[2u * SOURCES], normals[2u * POINTS], seen_from[2u * POINTS];
    static ek_icp icp;
    static history in_groups, singly;
    ek_icp_parameters parameters = ek_icp_default();
    uint32_t searches[2] = {0u, 0u};
    ek_arena arena = memory_of(400000u);
    CHECK(ek_icp_init(&icp, &arena, SOURCES, POINTS) == EK_OK && ek_icp_init_lines(&icp, &arena) == EK_OK);
    CHECK(ek_arena_check(&arena) == EK_OK && icp.grouped == EK_GROUPED);
    for (size_t k = 0; k < 2u * SOURCES; k++) { /* some have no neighbour */
        source[k] = cloud[k] + (lattice ? EK_R(0.125) * (ek_real)(k % 3u) : uniform(seed, -0.02, 0.02));
        source[k] += k % 40u == 0u ? EK_R(3.0) : EK_R(0.0);
    }
    for (size_t k = 0; k < 2u * POINTS; k++) {
        seen_from[k] = uniform(seed, -0.7, 0.7);
    }
    CHECK(ek_index_build(&index_, cloud, POINTS) == EK_OK);
    for (int turn = 0; turn < 24; turn++) {
        const ek_pose still = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
        const ek_pose guess = {uniform(seed, -0.1, 0.1), uniform(seed, -0.1, 0.1), uniform(seed, -0.03, 0.03)};
        const ek_pose start = lattice && turn % 2 ? still : guess;
        ek_match expected, found;
        parameters.epsilon = turn % 3 ? EK_R(1e-6) : EK_R(0.0);
        parameters.one_to_one = turn / 2 % 2;
        parameters.error_before = turn % 5 == 0;
        parameters.max_correspondence = turn % 7 == 6 ? EK_R(0.0) : EK_R(0.3);
        parameters.metric = turn % 4 < 2 ? EK_METRIC_POINT : EK_METRIC_LINE;
        parameters.share_noise = turn % 4 == 3;
        index_.seen_from = turn % 8 > 3 ? seen_from : NULL;
        parameters.origin_x = parameters.origin_y = EK_R(0.3);
        icp.wide = turn % 3 != 1 ? ek_wide() : 0;
        icp.grouped = EK_GROUPED;
        in_groups.iterations = singly.iterations = 0u;
        CHECK(ek_normals_defer(&index_, 8u, normals) == EK_OK);
        CHECK(ek_icp_register(&icp, &index_, source, SOURCES, start, &parameters, note, &in_groups, &found) == EK_OK);
        icp.grouped = 0;
        CHECK(ek_normals_defer(&index_, 8u, normals) == EK_OK);
        CHECK(ek_icp_register(&icp, &index_, source, SOURCES, start, &parameters, note, &singly, &expected) == EK_OK);
        CHECK(memcmp(&found.target_from_source, &expected.target_from_source, sizeof(ek_pose)) == 0);
        CHECK(found.error == expected.error && found.inliers == expected.inliers && found.inliers > 10);
        CHECK(found.iterations == expected.iterations && found.converged == expected.converged);
        CHECK(memcmp(in_groups.pairs, singly.pairs, in_groups.iterations * sizeof singly.pairs[0]) == 0);
        searches[0] += found.queries;
        searches[1] += expected.queries;
    }
    CHECK(EK_GROUPED ? searches[0] < searches[1] : searches[0] == searches[1]);
    free(arena.memory);
}

/* In single precision cells of 1 mm have no width there. */
static void far_away_nothing_is_found_in_groups_but_singly(void)
{
    const ek_real one[] = {-EK_MAX_COORDINATE, -EK_MAX_COORDINATE};
    ek_real x[EK_GROUP], y[EK_GROUP];
    ek_nearby found;
    for (size_t lane = 0; lane < EK_GROUP; lane++) {
        x[lane] = y[lane] = -EK_MAX_COORDINATE;
    }
    ek_index far;
    ek_arena arena = memory_of(4096u);
    CHECK(ek_index_init(&far, &arena, 1u, 16u) == EK_OK && ek_index_build(&far, one, 1u) == EK_OK);
    CHECK_NEAR(far.cells.cell, 1e-3, 1e-9);
    const int near = ek_index_nearby(&far, x, y, EK_R(1e-3), ek_wide(), &found);
    CHECK(near ? found.slot[0][0] == 0u && sizeof(ek_real) > 4u : sizeof(ek_real) == 4u);
    CHECK(ek_index_nearest(&far, x[0], y[0], EK_R(1.0), EK_R(1.0)).slot == 0u);
    free(arena.memory);
}

int main(void)
{
    uint64_t seed = 5u;
    ek_arena arena = memory_of(400000u);
    CHECK(ek_index_init(&index_, &arena, POINTS, 4000u) == EK_OK && ek_arena_check(&arena) == EK_OK);
    for (int lattice = 0; lattice < 2; lattice++) {
        if (lattice) {
            fill_lattice();
        } else {
            fill_room(&seed);
        }
        CHECK(ek_index_build(&index_, cloud, POINTS) == EK_OK);
        CHECK(all_bounds_hold(&seed, EK_R(0.1)) > 400 && all_bounds_hold(&seed, EK_R(0.6)) > 600);
        a_registration_is_the_same(&seed, lattice);
    }
    too_many_points_are_not_searched();
    far_away_nothing_is_found_in_groups_but_singly();
    free(arena.memory);
    return verdict();
}

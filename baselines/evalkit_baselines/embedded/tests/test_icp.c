#include "check.h"
#include "ek/icp.h"
#include "ek/normals.h"
#include "ek/wide.h"

#define SIDE 70u /* points per wall */
#define ROUND 200u
#define POINTS (4u * SIDE + ROUND)

static ek_real room[2u * POINTS], moved[2u * POINTS];
static ek_index reference;
static ek_icp icp;

/* The paper's scene: a room of 10 m x 10 m with a round pillar. */
static void build_room(void)
{
    size_t n = 0;
    for (unsigned k = 0; k < SIDE; k++) {
        const double along = 10.0 * k / (SIDE - 1.0);
        const double corners[4][2] = {{along, 0.0}, {10.0, along}, {along, 10.0}, {0.0, along}};
        for (int wall = 0; wall < 4; wall++, n++) {
            room[2u * n] = EK_R(corners[wall][0]);
            room[2u * n + 1u] = EK_R(corners[wall][1]);
        }
    }
    for (unsigned k = 0; k < ROUND; k++, n++) {
        const double angle = 2.0 * (double)EK_PI * k / ROUND;
        room[2u * n] = EK_R(2.0 + 1.5 * cos(angle));
        room[2u * n + 1u] = EK_R(8.0 + 1.5 * sin(angle));
    }
}

static void move_room(ek_pose pose)
{
    const ek_real c = EK_COS(pose.theta), s = EK_SIN(pose.theta);
    for (size_t k = 0; k < POINTS; k++) {
        moved[2u * k] = c * room[2u * k] - s * room[2u * k + 1u] + pose.x;
        moved[2u * k + 1u] = s * room[2u * k] + c * room[2u * k + 1u] + pose.y;
    }
}

static ek_match match_of(const ek_icp_parameters *parameters, ek_icp_trace trace, void *context)
{
    const ek_pose identity = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    ek_match match;
    memset(&match, 0, sizeof match);
    CHECK(ek_index_build(&reference, room, POINTS) == EK_OK);
    CHECK(ek_icp_register(&icp, &reference, moved, POINTS, identity, parameters, trace, context, &match) == EK_OK);
    return match;
}

/* Table 1: turned by 30 degrees, moved by (4, 5), noise of 4.83 cm on every coordinate, no guess. */
static void table_1_is_met(void)
{
    const ek_pose truth = {EK_R(4.0), EK_R(5.0), EK_PI / EK_R(6.0)};
    ek_icp_parameters parameters = ek_icp_default();
    uint64_t seed = 11u;
    parameters.max_correspondence = EK_R(0.0);
    move_room(ek_se2_inverse(truth));
    for (size_t k = 0; k < 2u * POINTS; k++) {
        for (int j = 0; j < 12; j++) { /* nearly Gaussian */
            moved[k] += uniform(&seed, -0.0483, 0.0483) / EK_R(2.0);
        }
    }
    const ek_match match = match_of(&parameters, NULL, NULL);
    CHECK(match.converged && match.iterations >= 19 && match.iterations <= 31);
    CHECK_NEAR(match.target_from_source.x, 4.0, 0.02);
    CHECK_NEAR(match.target_from_source.y, 5.0, 0.02);
    CHECK_NEAR(match.target_from_source.theta, truth.theta, 0.005);
    CHECK_NEAR(match.error, 0.0467, 0.005);
}

static void a_small_motion_is_found_exactly(void)
{
    const ek_pose truth = {EK_R(0.02), EK_R(-0.01), EK_R(0.004)};
    ek_icp_parameters parameters = ek_icp_default();
    parameters.one_to_one = 0; /* the room contains its corners twice */
    move_room(ek_se2_inverse(truth));
    const ek_match match = match_of(&parameters, NULL, NULL);
    CHECK(match.converged && match.inliers == (int)POINTS);
    CHECK_NEAR(match.target_from_source.x, truth.x, TOLERANCE);
    CHECK_NEAR(match.target_from_source.y, truth.y, TOLERANCE);
    CHECK_NEAR(match.target_from_source.theta, truth.theta, TOLERANCE);
    CHECK_NEAR(match.error, 0.0, TOLERANCE);
    CHECK(match.queries <
          (uint32_t)match.iterations * POINTS); /* some neighbours were proven unchanged, not searched */
}

typedef struct {
    const ek_icp_parameters *parameters;
    double error;
    int iterations;
} seen;

/* Every pair is the nearest neighbour, and each target point has one owner. */
static void inspect(void *context, const ek_icp_iteration *now)
{
    seen *const s = (seen *)context;
    static uint8_t owned[POINTS];
    memset(owned, 0, sizeof owned);
    CHECK(now->iteration == ++s->iterations);
    for (int k = 0; k < now->inliers; k++) {
        CHECK(now->target[k] < POINTS && now->source[k] < POINTS && (k == 0 || now->source[k] > now->source[k - 1]));
        CHECK(!s->parameters->one_to_one || !owned[now->target[k]]++);
    }
    s->error = (double)now->error;
}

static void a_trace_sees_every_step(int one_to_one, ek_error_measure error)
{
    const ek_pose away = {EK_R(0.1), EK_R(-0.05), EK_R(0.03)};
    ek_icp_parameters parameters = ek_icp_default();
    parameters.one_to_one = one_to_one;
    parameters.error = error;
    seen s = {&parameters, 0.0, 0};
    move_room(away);
    const ek_match match = match_of(&parameters, inspect, &s), again = match_of(&parameters, NULL, NULL);
    CHECK(s.iterations == match.iterations && match.iterations > 2);
    CHECK_NEAR(match.error, error == EK_ERROR_MEAN_SQUARED ? sqrt(s.error) : s.error, TOLERANCE);
    CHECK(memcmp(&match.target_from_source, &again.target_from_source, sizeof again.target_from_source) == 0);
}

static void of_rivals_the_closest_counts(void)
{
    const ek_real target[] = {EK_R(0), EK_R(0), EK_R(1), EK_R(0), EK_R(0), EK_R(1)};
    const ek_real source[] = {EK_R(0.2), EK_R(0), EK_R(0.1), EK_R(0), EK_R(1.1), EK_R(0),
                              EK_R(0), EK_R(1.1), EK_R(-0.1), EK_R(0)};
    const ek_pose identity = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    ek_icp_parameters parameters = ek_icp_default();
    ek_match match;
    parameters.max_iterations = 1;
    parameters.error_before = 1;
    CHECK(ek_index_build(&reference, target, 3u) == EK_OK);
    CHECK(ek_icp_register(&icp, &reference, source, 5u, identity, &parameters, NULL, NULL, &match) == EK_OK);
    CHECK(match.inliers == 3 && !match.converged);
    CHECK_NEAR(match.error, 0.1, TOLERANCE);
}

/* The square of the first distance is 1 + 2^-52 (2^-23), its root 1 like that of the second; whether places are searched in
 * groups, which compares squares, or singly, which compares distances. */
static void of_rivals_whose_squares_alone_differ_the_first_counts(void)
{
    const ek_real target[] = {EK_R(0), EK_R(0), EK_R(5), EK_R(0)};
    const ek_real source[] = {EK_R(1), EK_SQRT(EK_EPSILON), EK_R(1), EK_R(0), EK_R(5), EK_R(0)};
    const ek_pose identity = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    ek_icp_parameters parameters = ek_icp_default();
    parameters.max_iterations = 1;
    parameters.min_pairs = 2;
    parameters.max_correspondence = EK_R(2.0);
    CHECK(ek_index_build(&reference, target, 2u) == EK_OK);
    for (int grouped = 0; grouped < 2; grouped++) {
        ek_match match;
        icp.grouped = grouped && EK_GROUPED;
        CHECK(ek_icp_register(&icp, &reference, source, 3u, identity, &parameters, NULL, NULL, &match) == EK_OK);
        CHECK(match.inliers == 2 && icp.weight[0] == EK_R(1.0) && icp.weight[1] == EK_R(0.0));
    }
    icp.grouped = EK_GROUPED;
}

/* Hot loops run over a multiple of eight points: the others neither count nor cost a search, whatever was there before. */
static void padding_takes_no_part(void)
{
    const ek_pose identity = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    ek_icp_parameters parameters = ek_icp_default();
    parameters.one_to_one = 0;
    parameters.max_iterations = 1;
    parameters.error = EK_ERROR_MEAN_SQUARED;
    parameters.error_before = 1;
    build_room();
    CHECK(ek_index_build(&reference, room, POINTS) == EK_OK);
    for (size_t count = 3; count < 20u; count++) {
        ek_match match;
        double sum = 0.0;
        for (size_t k = 0; k < count; k++) { /* beside every tenth point of the room, the first one farthest */
            const double off = 0.02 / (1.0 + (double)k);
            moved[2u * k] = room[20u * k] + EK_R(off);
            moved[2u * k + 1u] = room[20u * k + 1u];
        }
        CHECK(ek_icp_register(&icp, &reference, room, POINTS, identity, &parameters, NULL, NULL, &match) == EK_OK);
        CHECK(match.queries == POINTS);
        CHECK(ek_icp_register(&icp, &reference, moved, count, identity, &parameters, NULL, NULL, &match) == EK_OK);
        CHECK(match.inliers == (int32_t)count && match.queries == count);
        for (size_t k = 0; k < count; k++) {
            double least = 1e9;
            for (size_t j = 0; j < POINTS; j++) {
                const double dx = (double)(moved[2u * k] - room[2u * j]), dy = (double)(moved[2u * k + 1u] - room[2u * j + 1u]);
                least = dx * dx + dy * dy < least ? dx * dx + dy * dy : least;
            }
            sum += least;
        }
        CHECK_NEAR(match.error, sqrt(sum / (double)count), 1e-5);
    }
}

static void too_few_pairs_give_the_guess(void)
{
    const ek_pose guess = {EK_R(100.0), EK_R(0.0), EK_R(1.0)};
    const ek_icp_parameters parameters = ek_icp_default();
    ek_match match;
    CHECK(ek_icp_register(&icp, &reference, room, POINTS, guess, &parameters, NULL, NULL, &match) == EK_OK);
    CHECK(match.inliers == 0 && !match.converged && isnan(match.error) && match.iterations == 0);
    CHECK(memcmp(&match.target_from_source, &guess, sizeof guess) == 0);
}

/* A limit beyond the distance that stands for "no neighbour" must not produce a pair. */
static void a_limit_beyond_all_is_no_limit(void)
{
    const ek_pose identity = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    ek_icp_parameters none = ek_icp_default(), huge = none;
    ek_match expected, found;
    none.max_correspondence = EK_R(0.0);
    huge.max_correspondence = EK_R(1e30);
    CHECK(ek_icp_register(&icp, &reference, room, POINTS, identity, &none, NULL, NULL, &expected) == EK_OK);
    CHECK(ek_icp_register(&icp, &reference, room, POINTS, identity, &huge, NULL, NULL, &found) == EK_OK);
    CHECK(memcmp(&found.target_from_source, &expected.target_from_source, sizeof found.target_from_source) == 0);
    CHECK(found.inliers == expected.inliers && found.inliers > 0);
    ek_index empty = reference;
    empty.count = 0u;
    CHECK(ek_icp_register(&icp, &empty, room, POINTS, identity, &huge, NULL, NULL, &found) == EK_OK);
    CHECK(found.inliers == 0 && !found.converged);
}

/* A room 4 m high above a wall 0.1 m thin, whose lower face alone is in the map: every 0.1 m a point of the side walls and the
 * ceiling, seen from (0, 2), and of the face at y = 0, seen from below. */
static size_t build_thin_wall(ek_real *xy, ek_real *seen_from, ek_real below)
{
    size_t n = 0;
    for (int k = 0; k < 60; k++) {
        const double along = -2.95 + 0.1 * k, points[4][2] = {{-3.0, along + 3.5}, {3.0, along + 3.5}, {along, 4.0}, {along, 0.0}};
        for (int wall = 0; wall < 4; wall++) {
            if (wall >= 2 || points[wall][1] < 4.0) {
                const double x = -points[wall][0], y = (wall < 3 ? 2.0 : -2.0) - points[wall][1], away = sqrt(x * x + y * y);
                xy[2u * n] = EK_R(points[wall][0]);
                xy[2u * n + 1u] = EK_R(points[wall][1]);
                seen_from[2u * n] = EK_R(x / away);
                seen_from[2u * n++ + 1u] = wall < 3 ? EK_R(y / away) : below;
            }
        }
    }
    return n;
}

static size_t kept; /* pairs of the last match there */

/* Error along y of a match with it of what is seen from `sensor` in the room: the upper face. */
static double error_at_thin_wall(int grouped, double sensor, ek_real below)
{
    static ek_real wall[2u * 240u], seen_from[2u * 240u], scan[2u * 240u], normals[2u * 240u], viewer[2];
    const ek_pose truth = {EK_R(0.5), EK_R(-1.0), EK_R(0.2)}; /* of the base: below the wall */
    const ek_real place[2] = {EK_R(0.0), EK_R(sensor)};
    const size_t count = build_thin_wall(wall, seen_from, below);
    ek_icp_parameters parameters = ek_icp_default();
    ek_arena arena = memory_of((size_t)1 << 20);
    ek_index index;
    ek_icp matcher;
    ek_match match;
    CHECK(ek_icp_init(&matcher, &arena, 240u, 240u) == EK_OK && ek_icp_init_lines(&matcher, &arena) == EK_OK);
    CHECK(ek_index_init(&index, &arena, 240u, 4096u) == EK_OK && ek_arena_check(&arena) == EK_OK);
    CHECK(ek_index_build(&index, wall, count) == EK_OK && ek_normals_defer(&index, 3u, normals) == EK_OK);
    matcher.grouped = matcher.grouped && grouped;
    index.seen_from = seen_from;
    memcpy(scan, wall, sizeof scan);
    for (size_t k = 0; k < count; k++) {
        scan[2u * k + 1u] += wall[2u * k + 1u] == EK_R(0.0) ? EK_R(0.1) : EK_R(0.0);
    }
    ek_se2_transform(ek_se2_inverse(truth), scan, count, scan);
    ek_se2_transform(ek_se2_inverse(truth), place, 1u, viewer);
    parameters.metric = EK_METRIC_LINE;
    parameters.one_to_one = 0;
    parameters.origin_x = viewer[0];
    parameters.origin_y = viewer[1];
    CHECK(ek_icp_register(&matcher, &index, scan, count, truth, &parameters, NULL, NULL, &match) == EK_OK);
    free(arena.memory);
    kept = (size_t)match.inliers;
    return (double)(match.target_from_source.y - truth.y);
}

static void the_face_behind_a_thin_wall_has_no_pairs(void)
{
    for (int grouped = 0; grouped < 2; grouped++) {
        CHECK_NEAR(error_at_thin_wall(grouped, 2.0, EK_R(-1.0)), 0.0, 1e-4);
        CHECK(kept == 130u); /* 60 of the ceiling and 35 of each side wall */
        CHECK_NEAR(error_at_thin_wall(grouped, 0.1, EK_R(-0.11)), 0.0, 1e-4);
        CHECK(error_at_thin_wall(grouped, 2.0, EK_R(1.0)) < -0.03);   /* seen from above before */
        CHECK(error_at_thin_wall(grouped, 2.0, EK_R(-0.09)) < -0.03); /* hardly from below */
        CHECK(error_at_thin_wall(grouped, -0.5, EK_R(-1.0)) < -0.03); /* this time from below */
        CHECK(error_at_thin_wall(grouped, 0.01, EK_R(-1.0)) < -0.03); /* along it, by 0.02, but for ten points */
        CHECK(kept == 180u);
    }
}

static void bad_input_is_named(void)
{
    const ek_pose identity = {EK_R(0.0), EK_R(0.0), EK_R(0.0)}, lost = {(ek_real)NAN, EK_R(0.0), EK_R(0.0)};
    const ek_icp_parameters good = ek_icp_default();
    ek_icp_parameters bad = good;
    ek_match match;
    CHECK(ek_icp_register(&icp, &reference, NULL, 5u, identity, &good, NULL, NULL, &match) == EK_NULL_POINTER);
    CHECK(ek_icp_register(&icp, &reference, room, 0u, identity, &good, NULL, NULL, &match) == EK_NO_POINTS);
    CHECK(ek_icp_register(&icp, &reference, room, POINTS + 1u, identity, &good, NULL, NULL, &match) ==
          EK_TOO_MANY_POINTS);
    CHECK(ek_icp_register(&icp, &reference, room, POINTS, lost, &good, NULL, NULL, &match) == EK_NOT_FINITE);
    bad.epsilon = -EK_R(1.0);
    CHECK(ek_icp_register(&icp, &reference, room, POINTS, identity, &bad, NULL, NULL, &match) == EK_OUT_OF_RANGE);
    bad = good;
    bad.origin_x = EK_R(2.0) * EK_MAX_COORDINATE;
    CHECK(ek_icp_register(&icp, &reference, room, POINTS, identity, &bad, NULL, NULL, &match) == EK_OUT_OF_RANGE);
    bad.origin_x = EK_R(0.0);
    bad.origin_y = -(ek_real)INFINITY;
    CHECK(ek_icp_register(&icp, &reference, room, POINTS, identity, &bad, NULL, NULL, &match) == EK_OUT_OF_RANGE);
    moved[3] = (ek_real)INFINITY;
    CHECK(ek_icp_register(&icp, &reference, moved, POINTS, identity, &good, NULL, NULL, &match) == EK_NOT_FINITE);
}

int main(void)
{
    ek_arena arena = memory_of(400000u);
    CHECK(ek_index_init(&reference, &arena, POINTS, 8192u) == EK_OK);
    CHECK(ek_icp_init(&icp, &arena, POINTS, POINTS) == EK_OK && ek_arena_check(&arena) == EK_OK);
    build_room();
    table_1_is_met();
    a_small_motion_is_found_exactly();
    a_trace_sees_every_step(1, EK_ERROR_MEAN);
    a_trace_sees_every_step(0, EK_ERROR_RMSE);
    a_trace_sees_every_step(1, EK_ERROR_MEAN_SQUARED);
    padding_takes_no_part();
    of_rivals_the_closest_counts();
    of_rivals_whose_squares_alone_differ_the_first_counts();
    too_few_pairs_give_the_guess();
    a_limit_beyond_all_is_no_limit();
    the_face_behind_a_thin_wall_has_no_pairs();
    bad_input_is_named();
    free(arena.memory);
    return verdict();
}

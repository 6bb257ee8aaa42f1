/* Which place is compared with the last keyframe, and when a match passes, each on both sides of its bound. */
#include "src/loop_judge.c"
#include "src/loop_places.c"

#include "line.h"

/* As `line_of`, with the keyframes where they are given and as far apart through the graph as given. */
static ek_arena places(size_t count, const double (*at)[3])
{
    ek_arena arena = line_of(count);
    for (size_t k = 0; k < count; k++) {
        slam.keyframes.graph.pose[k] = pose_of(at[k][0], at[k][1], 0.0);
        slam.keyframes.apart[k] = EK_R(at[k][2]);
    }
    return arena;
}

/* The nearest keyframe at least 15 m apart through the graph, within 1 m and a tenth of that, at most 7 m. */
static void the_nearest_place_lies_within_the_drift(void)
{
    static const struct {
        double x, y, apart;
        int found;
    } cases[] = {{2.5, 0.0, 15.0, 1},  {0.0, -2.5, 15.0, 1}, {2.51, 0.0, 15.0, 0},  {1.8, 1.8, 15.0, 0}, {1.7, 1.7, 15.0, 1},
                 {0.1, 0.1, 14.99, 0}, {7.0, 0.0, 60.0, 1},  {7.0, 0.0, 1000.0, 1}, {7.01, 0.0, 1000.0, 0},
                 {0.0, 0.0, 1e9, 0},   {0.0, 0.0, 9.9e8, 1}};
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        const double at[][3] = {{100.0, 0.0, 50.0}, {cases[k].x, cases[k].y, cases[k].apart}, {0.0, 0.0, 0.0}};
        ek_arena arena = places(3u, at);
        CHECK(nearest_place(&slam.finder, &slam.keyframes, ORIGIN) == (cases[k].found ? 1u : 3u));
        free(arena.memory);
    }
    static const double several[][3] = {{10.0, 3.0, 90.0}, {10.0, -1.0, 90.0}, {10.0, 1.0, 90.0}, {10.0, 2.0, 90.0}, {0.0, 0.0, 0.0}};
    ek_arena arena = places(5u, several);
    CHECK(nearest_place(&slam.finder, &slam.keyframes, pose_of(10.0, 0.0, 2.0)) == 1u); /* the first of the nearest */
    CHECK(nearest_place(&slam.finder, &slam.keyframes, pose_of(10.0, 1.6, 0.0)) == 3u);
    free(arena.memory);
}

/* Of another part of the drive: those not connected, or by odometry alone, within 7 m. */
static void the_nearest_place_of_another_part_lies_within_the_radius(void)
{
    static const double at[][3] = {{1.0, 0.0, 9e8}, {0.0, 7.0, 1e9}, {3.0, -7.0, 1e12}, {-7.0, 0.0, 1e9}, {0.0, 0.0, 0.0}};
    ek_arena arena = places(5u, at);
    CHECK(nearest_other_part(&slam.finder, &slam.keyframes, ORIGIN) == 1u);
    CHECK(nearest_other_part(&slam.finder, &slam.keyframes, pose_of(3.0, -1.0, 1.0)) == 2u);
    CHECK(nearest_other_part(&slam.finder, &slam.keyframes, pose_of(-0.01, 0.0, 0.0)) == 3u);
    CHECK(nearest_other_part(&slam.finder, &slam.keyframes, pose_of(20.0, 20.0, 0.0)) == 5u);
    CHECK(is_apart(&slam.keyframes));
    for (size_t k = 0; k < 5u; k++) {
        slam.keyframes.apart[k] = EK_R(9.99e8);
    }
    CHECK(!is_apart(&slam.keyframes));
    CHECK(nearest_other_part(&slam.finder, &slam.keyframes, ORIGIN) == 5u);
    free(arena.memory);
}

/* Keyframes 1 m apart, of which those of the other part are looked at 3.5 m of path after each other, then from the first. */
static void all_places_are_looked_at_in_steps_of_half_a_radius(void)
{
    static const size_t expected[] = {2u, 6u, 10u, 2u, 6u};
    ek_arena arena = line_of(16u);
    for (size_t k = 2; k < 12u; k++) {
        slam.keyframes.apart[k] = EK_APART;
    }
    for (size_t k = 0; k < 5u; k++) {
        CHECK(next_of_all(&slam.finder, &slam.keyframes) == expected[k]);
        CHECK(slam.finder.next_place == (k % 3u == 2u ? 14u : expected[k] + 4u));
    }
    slam.finder.next_place = 40u; /* behind all: as the last one */
    CHECK(next_of_all(&slam.finder, &slam.keyframes) == 2u);
    slam.finder.settings.radius = EK_R(8.0); /* exactly 4 m */
    slam.finder.next_place = 0u;
    CHECK(next_of_all(&slam.finder, &slam.keyframes) == 2u && slam.finder.next_place == 6u);
    free(arena.memory);
}

/* Beside an unconfirmed candidate, 2 m behind it: 1 m ahead of keyframe 3, turned to the left, then 2 m on. */
static void another_candidate_is_expected_beside_the_last(void)
{
    for (int apart = 0; apart < 2; apart++) {
        ek_arena arena = line_of(30u);
        ek_loop_candidate beside;
        memset(&beside, 0, sizeof beside);
        beside.edge = edge_of(3u, 27u, pose_of(1.0, 0.0, 0.5 * (double)EK_PI), 1.0);
        beside.known = 1;
        slam.keyframes.apart[3] = slam.keyframes.apart[4] = EK_R(apart ? 1e9 : 9e8);
        const place at = expected_place(&slam.finder, &slam.keyframes, &beside);
        CHECK(at.row == 4u && at.known && !at.turned);
        CHECK_NEAR(at.pose.x, 4.0, TOLERANCE);
        CHECK_NEAR(at.pose.y, 2.0, TOLERANCE);
        CHECK_NEAR(at.pose.theta, 0.5 * (double)EK_PI, TOLERANCE);
        CHECK(ek_loop_finder_begin(&slam.finder, &slam.keyframes, &beside, 1, &work));
        CHECK(slam.finder.candidate.edge.first == 4u && slam.finder.candidate.edge.second == 29u);
        CHECK(slam.finder.apart == apart && slam.finder.phase == EK_FINDER_PREDICT && isnan(slam.finder.candidate.chi));
        CHECK_NEAR(slam.finder.motion.x, 25.0, TOLERANCE); /* known: as the graph has it */
        beside.known = 0;
        slam.finder.tried = 0;
        CHECK(ek_loop_finder_begin(&slam.finder, &slam.keyframes, &beside, 1, &work) && !slam.finder.turned);
        CHECK_NEAR(slam.finder.motion.x, 0.0, TOLERANCE); /* otherwise from the candidate */
        CHECK_NEAR(slam.finder.motion.y, 2.0, TOLERANCE);
        CHECK_NEAR(slam.finder.covariance.xx, 1e4, 1e-3);
        CHECK_NEAR(slam.finder.covariance.tt, 1e2, 1e-5);
        free(arena.memory);
    }
}

/* From one candidate to the next 1 m of path; the first keyframe is compared with none. */
static void candidates_keep_their_distance(void)
{
    static const double tried_at[] = {18.01, 18.0, 17.5};
    ek_arena arena = line_of(1u);
    CHECK(!ek_loop_finder_begin(&slam.finder, &slam.keyframes, NULL, 1, &work));
    free(arena.memory);
    for (size_t k = 0; k < 4u; k++) {
        arena = line_of(20u);
        slam.keyframes.graph.pose[19] = pose_of(1.5, 0.0, 0.0); /* beside keyframes 1 and 2, 18 and 17 m apart */
        slam.finder.tried = k > 0u;
        slam.finder.tried_at = EK_R(k ? tried_at[k - 1u] : 19.0);
        ek_work spent = ek_work_make(INT64_MAX);
        CHECK(ek_loop_finder_begin(&slam.finder, &slam.keyframes, NULL, 1, &spent) == (k != 1u));
        CHECK(spent.done == (k == 1u ? 0u : 80u));
        CHECK(k == 1u || (slam.finder.tried && slam.finder.candidate.edge.first == 1u && slam.finder.candidate.known));
        CHECK_NEAR(slam.finder.tried_at, k == 1u ? 18.01 : 19.0, 1e-6);
        free(arena.memory);
    }
}

/* Within twice the gate, 22.69, of the sum of the prediction's variance, 0.015^2 m^2 or 0.004^2, and a cell of 0.1 m or
 * 0.01 rad. */
static void a_motion_is_possible_within_twice_the_gate(void)
{
    const ek_sym3 spread = {EK_R(0.04), EK_R(0.0), EK_R(0.0), EK_R(0.09), EK_R(0.0), EK_R(0.0025)};
    const double sigma[] = {sqrt(0.04 + 0.000225 + 0.01), sqrt(0.09 + 0.000225 + 0.01), sqrt(0.0025 + 0.000016 + 0.0001)};
    ek_arena arena = line_of(2u);
    slam.finder.covariance = spread;
    slam.finder.motion = ORIGIN;
    for (size_t axis = 0; axis < 3u; axis++) {
        for (int beyond = 0; beyond < 2; beyond++) {
            const double by = sigma[axis] * sqrt(22.69) * (beyond ? 1.001 : 0.999);
            const ek_pose motion = pose_of(axis == 0u ? by : 0.0, axis == 1u ? by : 0.0, axis == 2u ? -by : 0.0);
            CHECK(ek_loop_is_possible(&slam.finder, motion) == !beyond);
        }
    }
    free(arena.memory);
}

/* As `line_of`, with a match of 40 points on two walls with themselves. */
static ek_arena two_walls(void)
{
    ek_arena arena = line_of(2u);
    ek_loop_finder *const finder = &slam.finder;
    for (size_t k = 0; k < 40u; k++) {
        finder->target[2u * k] = EK_R(k < 20u ? 0.2 * (double)k : 4.0);
        finder->target[2u * k + 1u] = EK_R(k < 20u ? 0.0 : 0.2 * (double)(k - 20u));
    }
    memcpy(finder->source, finder->target, 80u * sizeof(ek_real));
    finder->source_count = 40u;
    CHECK(ek_index_build(&finder->index, finder->target, 40u) == EK_OK);
    CHECK(ek_normals_compute(&finder->index, 8u, EK_FAR, finder->normals) == EK_OK);
    finder->index.normals = finder->normals;
    finder->match = finder->motion = ORIGIN;
    finder->covariance = edge_of(0u, 1u, ORIGIN, 1.0).information;
    finder->match_error = EK_R(0.02);
    return arena;
}

/* Put the first `far` source points beside their wall. */
static void move_beside(ek_loop_finder *finder, size_t far)
{
    for (size_t k = 0; k < 40u; k++) {
        finder->source[2u * k + 1u] = finder->target[2u * k + 1u] + (k < far ? EK_R(-0.2) : EK_R(0.0));
    }
}

/* Source points on a wall, some beside it: the share on it, and then the certainty of the match, must be enough. */
static void a_match_passes_with_enough_overlap_and_certainty(void)
{
    ek_arena arena = two_walls();
    ek_loop_finder *const finder = &slam.finder;
    for (size_t far = 11; far < 14u; far++) { /* of 40, 28 are 70 % */
        finder->source_count = 40u;
        move_beside(finder, far);
        finder->candidate.outcome = EK_LOOP_SCORE;
        ek_loop_judge(finder, &work);
        CHECK((finder->candidate.outcome == EK_LOOP_OVERLAP) == (far == 13u) && finder->phase == EK_FINDER_IDLE);
        CHECK(far == 13u || finder->candidate.outcome == EK_LOOP_PASSED);
        CHECK_NEAR(finder->candidate.number[far == 13u ? 0 : 1], (40.0 - (double)far) / 40.0, 1e-6);
    }
    memcpy(finder->source, finder->target, 80u * sizeof(ek_real));
    finder->settings.degenerate = EK_R(1e-6); /* the loosest direction is told */
    ek_loop_judge(finder, &work);
    CHECK(finder->candidate.outcome == EK_LOOP_DEGENERATE);
    const ek_real loosest = finder->candidate.number[0];
    CHECK(loosest > EK_R(0.015) && loosest < EK_R(0.15));
    for (int k = 0; k < 2; k++) {
        finder->settings.degenerate = loosest * EK_R(k ? 1.0001 : 0.9999);
        ek_loop_judge(finder, &work);
        CHECK(finder->candidate.outcome == (k ? EK_LOOP_PASSED : EK_LOOP_DEGENERATE));
    }
    const ek_sym3 *const information = &finder->candidate.edge.information; /* its largest eigenvalue */
    ek_sym3 covariance;
    CHECK(ek_sym3_inverse(information, &covariance));
    const double mean = 0.5 * (double)(covariance.xx + covariance.yy), half = 0.5 * (double)(covariance.xx - covariance.yy);
    CHECK_NEAR((double)loosest * (double)loosest, mean + sqrt(half * half + (double)(covariance.xy * covariance.xy)), 1e-7);
    finder->motion = pose_of(0.0, 2.0, 0.0);
    ek_loop_judge(finder, &work);
    const double chi = 4.0 / (1.0 + (double)covariance.yy); /* hardly correlated with the other directions */
    CHECK_NEAR(finder->candidate.chi, chi, 0.05);
    const ek_real exact = finder->candidate.chi;
    for (int k = 0; k < 2; k++) {
        finder->settings.gate = exact * EK_R(k ? 1.0 : 0.9999);
        ek_loop_judge(finder, &work);
        CHECK(finder->candidate.outcome == (k ? EK_LOOP_PASSED : EK_LOOP_CHI));
    }
    free(arena.memory);
}

/* Where the graph predicts the motion, three quarters of score and overlap are enough for a look at what is missing, if the
 * position is known twice as well. */
static void a_match_in_part_is_looked_at(void)
{
    static const struct {
        size_t far; /* of 40 points */
        double score;
        int known, apart;
        ek_loop_outcome outcome;
        ek_finder_phase phase;
    } cases[] = {{12u, 0.6, 1, 0, EK_LOOP_PASSED, EK_FINDER_IDLE}, {13u, 0.6, 1, 0, EK_LOOP_PASSED, EK_FINDER_LOOK},
                 {18u, 0.6, 1, 0, EK_LOOP_PASSED, EK_FINDER_LOOK}, {0u, 0.5, 1, 0, EK_LOOP_PASSED, EK_FINDER_LOOK},
                 {20u, 0.6, 1, 0, EK_LOOP_OVERLAP, EK_FINDER_IDLE}, {13u, 0.6, 0, 0, EK_LOOP_OVERLAP, EK_FINDER_IDLE},
                 {13u, 0.6, 1, 1, EK_LOOP_OVERLAP, EK_FINDER_IDLE}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        ek_arena arena = two_walls();
        ek_loop_finder *const finder = &slam.finder;
        move_beside(finder, cases[i].far);
        finder->best_score = EK_R(cases[i].score);
        finder->candidate.known = cases[i].known;
        finder->apart = cases[i].apart;
        finder->settings.degenerate = EK_R(1e6);
        ek_loop_judge(finder, &work);
        CHECK(finder->candidate.outcome == cases[i].outcome && finder->phase == cases[i].phase);
        CHECK(finder->on_map == 40u - cases[i].far && finder->missing == cases[i].far);
        const int is_low = cases[i].outcome == EK_LOOP_OVERLAP;
        CHECK_NEAR(finder->candidate.number[1], is_low ? (cases[i].known && !cases[i].apart ? 0.525 : 0.7)
                                                       : (double)finder->on_map / 40.0, 1e-6);
        for (size_t k = 0; k < finder->missing; k++) {
            CHECK_NEAR(finder->raw[2u * (finder->on_map + k) + 1u], -0.2, 1e-6);
        }
        if (!is_low) { /* the position must be known twice as well for a look */
            finder->settings.degenerate = EK_R(0.0);
            ek_loop_judge(finder, &work);
            const ek_real loosest = finder->candidate.number[0];
            const int looks = cases[i].phase == EK_FINDER_LOOK;
            for (int k = 0; k < 2; k++) {
                finder->settings.degenerate = loosest * EK_R((looks ? 2.0 : 1.0) * (k ? 1.0001 : 0.9999));
                ek_loop_judge(finder, &work);
                CHECK(finder->candidate.outcome == (k ? EK_LOOP_PASSED : EK_LOOP_DEGENERATE));
            }
        }
        free(arena.memory);
    }
}

/* Keyframes at 0, 0 and 1, 0 saw a point 1 m to their left each, and nothing else. What is missing there within 5 deg, up to
 * 0.15 m behind it, they could have seen. */
static void what_could_be_seen_contradicts(void)
{
    static const struct {
        double missing[2][2];
        size_t on_map, hidden;
    } cases[] = {{{{0.0, 0.5}, {0.0, 1.2}}, 19u, 1u},   {{{0.0, 0.5}, {0.0, 1.14}}, 19u, 0u},
                 {{{1.0, 0.5}, {0.0, -0.5}}, 19u, 1u},  {{{0.05, 0.6}, {0.06, 0.6}}, 19u, 1u},
                 {{{1.0, 1.14}, {1.0, 1.16}}, 18u, 1u}, {{{2.0, 0.5}, {0.5, 0.5}}, 1u, 2u}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        ek_arena arena = line_of(4u);
        ek_loop_finder *const finder = &slam.finder;
        const size_t on_map = cases[i].on_map, all = on_map + 2u, hidden = cases[i].hidden;
        finder->sight.ray = (ek_sight_ray *)finder->sample;
        finder->sight.other = (ek_sight_ray *)finder->normals;
        finder->candidate.edge.first = 0u;
        finder->candidate.outcome = EK_LOOP_PASSED;
        finder->candidate.number[1] = EK_R(0.6);
        finder->source_count = all;
        finder->on_map = on_map;
        finder->missing = 2u;
        for (size_t k = 0; k < 4u; k++) {
            finder->raw[2u * on_map + k] = EK_R(cases[i].missing[k / 2u][k % 2u]);
        }
        finder->phase = EK_FINDER_LOOK;
        finder->gathered = 0u;
        finder->gather_end = 2u;
        work = ek_work_make(1); /* one keyframe in a part */
        ek_loop_look(finder, &slam.keyframes, &work);
        CHECK(finder->phase == EK_FINDER_LOOK && finder->gathered == 1u && work.done == 150u);
        work = ek_work_make(INT64_MAX);
        ek_loop_look(finder, &slam.keyframes, &work);
        CHECK(finder->phase == EK_FINDER_IDLE && finder->missing == hidden);
        const double share = (double)on_map / (double)(all - hidden);
        CHECK(finder->candidate.outcome == (share >= 0.95 ? EK_LOOP_PASSED : EK_LOOP_CONTRADICTED));
        CHECK_NEAR(finder->candidate.number[0], share >= 0.95 ? 0.0 : share, 1e-6);
        CHECK_NEAR(finder->candidate.number[1], share >= 0.95 ? 0.6 : 0.95, 1e-6);
        free(arena.memory);
    }
}

int main(void)
{
    the_nearest_place_lies_within_the_drift();
    the_nearest_place_of_another_part_lies_within_the_radius();
    all_places_are_looked_at_in_steps_of_half_a_radius();
    another_candidate_is_expected_beside_the_last();
    candidates_keep_their_distance();
    a_motion_is_possible_within_twice_the_gate();
    a_match_passes_with_enough_overlap_and_certainty();
    a_match_in_part_is_looked_at();
    what_could_be_seen_contradicts();
    return verdict();
}

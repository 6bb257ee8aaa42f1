/* What a candidate is matched with: keyframes, windows, rivals and samples, each by hand. */
#include "src/loop_finder.c"

#include "line.h"

/* Keyframes of the same part of the drive up to 3 m of path on either side, as far as their points fit. */
static void keyframes_near_one_are_selected(void)
{
    static const struct {
        size_t row, capacity;
        double reach;
        uint32_t low, high;
    } cases[] = {{10u, 64u, 3.0, 7u, 14u},   {10u, 64u, 2.99, 8u, 13u}, {0u, 64u, 3.0, 0u, 4u},    {14u, 64u, 3.0, 11u, 15u},
                 {15u, 64u, 3.0, 15u, 19u},  {19u, 64u, 3.0, 16u, 20u}, {10u, 1u, 3.0, 10u, 11u}, {10u, 2u, 3.0, 9u, 11u},
                 {10u, 3u, 3.0, 9u, 12u},    {10u, 4u, 3.0, 8u, 12u},   {10u, 0u, 3.0, 10u, 10u}, {10u, 64u, 0.0, 10u, 11u}};
    ek_arena arena = line_of(15u);
    add_keyframe(1.0, EK_STEP_UNKNOWN);
    for (size_t k = 16; k < 20u; k++) {
        add_keyframe(1.0, EK_STEP_MATCHED);
    }
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        slam.finder.capacity = cases[k].capacity;
        slam.finder.raw_count = 99u;
        select_near(&slam.finder, &slam.keyframes, cases[k].row, EK_R(cases[k].reach));
        CHECK(slam.finder.gathered == cases[k].low && slam.finder.gather_end == cases[k].high && slam.finder.raw_count == 0u);
    }
    free(arena.memory);
}

/* Points come in the frame of the keyframe, which here looks to the left: the others' are behind and ahead of it. */
static void points_are_gathered_in_the_keyframes_frame(void)
{
    for (int slices = 0; slices < 2; slices++) {
        ek_arena arena = line_of(6u);
        slam.keyframes.graph.pose[3].theta = EK_R(0.5) * EK_PI;
        slam.finder.gathered = 2u;
        slam.finder.gather_end = 5u;
        slam.finder.raw_count = 0u;
        unsigned parts = 1u;
        ek_work slice = ek_work_make(slices ? 1 : INT64_MAX);
        for (; !gather(&slam.finder, &slam.keyframes, 3u, &slice); parts++) {
            CHECK(slice.done == 5u);
            slice = ek_work_make(1);
        }
        CHECK(parts == (slices ? 3u : 1u) && slam.finder.raw_count == 3u);
        static const double expected[] = {1.0, 1.0, 0.0, 1.0, 1.0, -1.0};
        for (size_t k = 0; k < 6u; k++) {
            CHECK_NEAR(slam.finder.raw[k], expected[k], TOLERANCE);
        }
        free(arena.memory);
    }
}

/* Three sigma of the prediction, turned into the frame of the first keyframe: from 0.3 m and 3 degrees up to 7 m and 30. */
static void the_window_holds_three_sigma(void)
{
    const double degree = (double)EK_PI / 180.0;
    const struct {
        double xx, yy, tt, theta, x, y, turn;
        int local;
    } cases[] = {{0.04, 0.01, 0.0025, 0.0, 0.6, 0.3, 0.15, 1},   {0.04, 0.0625, 0.0025, 0.5 * (double)EK_PI, 0.75, 0.6, 0.15, 1},
                 {0.0009, 0.0, 1e-6, 0.0, 0.3, 0.3, 3.0 * degree, 1}, {25.0, 0.04, 1.0, 0.0, 7.0, 0.6, 30.0 * degree, 0},
                 {0.04, 0.0626, 0.0, 0.0, 0.6, 3.0 * sqrt(0.0626), 3.0 * degree, 0}};
    ek_arena arena = line_of(2u);
    ek_loop_finder *const finder = &slam.finder;
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        const ek_sym3 spread = {EK_R(cases[k].xx), EK_R(0.0), EK_R(0.0), EK_R(cases[k].yy), EK_R(0.0), EK_R(cases[k].tt)};
        finder->covariance = spread;
        finder->motion = pose_of(3.0, 2.0, cases[k].theta);
        finder->turned = 0;
        fit_window(finder);
        CHECK_NEAR(finder->half[0], cases[k].x, 1e-6);
        CHECK_NEAR(finder->half[1], cases[k].y, 1e-6);
        CHECK_NEAR(finder->half[2], cases[k].turn, 1e-6);
        CHECK(finder->candidate.is_local == cases[k].local || k == 1u); /* there rounding decides */
        finder->turned = 1;
        fit_window(finder);
        CHECK_NEAR(finder->half[0], 3.5, 0.0);
        CHECK_NEAR(finder->half[1], 3.5, 0.0);
        CHECK_NEAR(finder->half[2], EK_PI, 0.0);
        CHECK(!finder->candidate.is_local);
    }
    free(arena.memory);
}

/* A window of 4 m x 2 m: a better match than the best is sought beside it by more than half a metre, in up to four boxes,
 * and where the graph predicts nothing, at the best place with any other heading. */
static void rivals_are_sought_around_the_best_motion(void)
{
    const double far = (double)EK_PI * 160.0 / 180.0;
    const double boxes[5][6] = {{9.25, 20.0, 0.3, 1.25, 1.0, 0.2}, {11.75, 20.0, 0.3, 0.25, 1.0, 0.2},
                                {11.0, 19.35, 0.3, 0.5, 0.35, 0.2}, {11.0, 20.85, 0.3, 0.5, 0.15, 0.2},
                                {11.0, 20.2, 0.5 - (double)EK_PI, 0.5, 0.5, far}};
    ek_arena arena = line_of(2u);
    ek_loop_finder *const finder = &slam.finder;
    static const ek_real point[] = {EK_R(1.0), EK_R(0.0)};
    ek_score_grid_draw(&finder->grid, &finder->thinner, point, 1u, EK_R(0.1), EK_R(0.0), EK_R(0.0), finder->raw, &work);
    finder->sample[0] = finder->sample[1] = EK_R(1.0);
    finder->sample_count = 1u;
    finder->motion = pose_of(10.0, 20.0, 0.3);
    finder->best_score = EK_R(0.75);
    finder->half[0] = EK_R(2.0);
    finder->half[1] = EK_R(1.0);
    finder->half[2] = EK_R(0.2);
    finder->best = pose_of(11.0, 20.2, 0.5);
    for (int known = 0; known < 2; known++) {
        finder->candidate.known = known;
        for (uint32_t k = 0; k < 5u; k++) {
            finder->rival = k;
            CHECK(begin_rival(finder) == (k < 4u || !known));
            const ek_search_window *const window = &finder->search.window;
            const ek_real found[] = {window->centre.x, window->centre.y, window->centre.theta, window->x, window->y, window->theta};
            for (size_t i = 0; i < 6u && (k < 4u || !known); i++) {
                CHECK_NEAR(found[i], boxes[k][i], 1e-5);
            }
            CHECK_NEAR(finder->search.score, 0.69, 1e-6);
        }
    }
    finder->candidate.known = 1;
    finder->best = pose_of(11.5, 20.5, 0.3); /* at half a metre from two edges of the window */
    for (uint32_t k = 0; k < 5u; k++) {
        finder->rival = k;
        CHECK(begin_rival(finder) == (k < 3u) && finder->rival == (k == 0u ? 0u : k < 3u ? 2u : 5u));
    }
    free(arena.memory);
}

/* At most 599 of the points are searched with: every one of 599, every second one of 600 and of 601. */
static void samples_are_taken_evenly(void)
{
    static const size_t counts[] = {1u, 599u, 600u, 601u, 899u, 900u}, taken[] = {1u, 599u, 300u, 301u, 450u, 300u};
    static ek_real source[2u * 900u], sample[2u * 900u];
    ek_arena arena = line_of(2u);
    ek_loop_finder *const finder = &slam.finder;
    ek_real *const own_source = finder->source, *const own_sample = finder->sample;
    for (size_t k = 0; k < 900u; k++) {
        source[2u * k] = EK_R(k);
        source[2u * k + 1u] = EK_R(-2.0 * (double)k);
    }
    finder->source = source;
    finder->sample = sample;
    finder->search.capacity = 900u;
    finder->grid.cell = EK_R(0.1);
    finder->motion = pose_of(1.0, 2.0, 0.5);
    finder->half[0] = EK_R(3.0);
    finder->half[1] = EK_R(1.5);
    finder->half[2] = EK_R(0.3);
    for (size_t k = 0; k < sizeof counts / sizeof *counts; k++) {
        const size_t every = counts[k] < 600u ? 1u : counts[k] / 300u;
        finder->source_count = counts[k];
        begin_search(finder);
        CHECK(finder->sample_count == taken[k] && finder->phase == EK_FINDER_SEARCH && finder->search.count == taken[k]);
        for (size_t i = 0; i < taken[k]; i++) {
            CHECK_NEAR(sample[2u * i], (double)(i * every), 0.0);
            CHECK_NEAR(sample[2u * i + 1u], -2.0 * (double)(i * every), 0.0);
        }
    }
    CHECK_NEAR(finder->search.window.x, 3.0, 0.0);
    CHECK_NEAR(finder->search.prior.x, 1.0, 1e-6); /* of three sigma, one */
    CHECK_NEAR(finder->search.prior.y, 0.5, 1e-6);
    CHECK_NEAR(finder->search.prior.theta, 0.1, 1e-6);
    CHECK_NEAR(finder->search.score, 0.55, 1e-6);
    finder->source = own_source;
    finder->sample = own_sample;
    free(arena.memory);
}

/* The phases of a candidate that are over at once: which follows, and with what. */
static void phases_follow_each_other(void)
{
    ek_arena arena = line_of(20u);
    ek_loop_finder *const finder = &slam.finder;
    finder->candidate.known = 0;
    finder->candidate.edge.first = 10u;
    finder->candidate.edge.second = 19u;
    for (int apart = 0; apart < 2; apart++) { /* 3 m of path of a connected part, 7 m of another one */
        finder->apart = apart;
        finder->phase = EK_FINDER_PREDICT;
        predict(finder, &slam.keyframes, &work);
        CHECK(finder->phase == EK_FINDER_TARGET);
        CHECK(finder->gathered == (apart ? 3u : 7u) && finder->gather_end == (apart ? 18u : 14u));
    }
    take_maps(finder, &slam.keyframes, &work);
    CHECK(finder->phase == EK_FINDER_SOURCE && finder->target_count == 15u);
    CHECK(finder->gathered == 16u && finder->gather_end == 20u);
    take_maps(finder, &slam.keyframes, &work); /* 4 points are too few */
    CHECK(finder->phase == EK_FINDER_IDLE && finder->candidate.outcome == EK_LOOP_FEW_POINTS && finder->source_count == 4u);
    CHECK_NEAR(finder->candidate.number[0], 4.0, 0.0);
    for (size_t few = 49; few < 51u; few++) { /* fewer than 50, on either side */
        for (int side = 0; side < 2; side++) {
            for (size_t k = 0; k < 64u; k++) {
                finder->raw[2u * k] = EK_R(k);
                finder->raw[2u * k + 1u] = EK_R(0.0);
            }
            finder->phase = EK_FINDER_SOURCE;
            finder->gathered = finder->gather_end = 20u;
            finder->raw_count = side ? 60u : few;
            finder->target_count = side ? few : 60u;
            take_maps(finder, &slam.keyframes, &work);
            CHECK(finder->phase == (few < 50u ? EK_FINDER_IDLE : EK_FINDER_DRAW));
        }
    }
    for (int apart = 0; apart < 2; apart++) { /* cells of 0.1 m, and of twice that after a lost track */
        finder->apart = apart;
        finder->target_count = 1u;
        finder->target[0] = finder->target[1] = EK_R(0.0);
        draw(finder, &work);
        CHECK(finder->phase == EK_FINDER_RAISE && finder->level == 1u);
        CHECK_NEAR(finder->grid.cell, apart ? 0.2 : 0.1, 1e-6);
    }
    finder->best = pose_of(1.0, 2.0, 0.5);
    finder->target_count = 2u;
    finder->target[2] = EK_R(1.0);
    finder->target[3] = EK_R(0.0);
    ek_work spent = ek_work_make(INT64_MAX);
    index_target(finder, &spent);
    CHECK(spent.done == 320u && finder->phase == EK_FINDER_COARSE && finder->index.normals == finder->normals);
    CHECK_NEAR(finder->match.y, 2.0, 0.0);
    CHECK_NEAR(finder->normals[1], 1.0, TOLERANCE);
    free(arena.memory);
}

/* A candidate that is not known may be confused with another in the whole radius, at any heading. */
static void the_search_ends_with_a_motion_or_without(void)
{
    static const ek_real point[] = {EK_R(1.05), EK_R(0.05)};
    ek_arena arena = line_of(2u);
    ek_loop_finder *const finder = &slam.finder;
    ek_score_grid_draw(&finder->grid, &finder->thinner, point, 1u, EK_R(0.1), EK_R(0.0), EK_R(0.0), finder->raw, &work);
    for (uint32_t level = 1; level < EK_SCORE_LEVELS; level++) {
        ek_score_grid_raise(&finder->grid, level, &work);
    }
    memcpy(finder->source, point, sizeof point);
    finder->source_count = 1u;
    finder->settings.ambiguity = EK_R(1.0);
    for (int k = 0; k < 4; k++) {
        const int known = k % 2, found = k / 2;
        finder->candidate.known = known;
        finder->candidate.outcome = EK_LOOP_PASSED;
        finder->motion = pose_of(found ? 0.0 : 50.0, 0.0, 0.0);
        finder->half[0] = finder->half[1] = EK_R(0.3);
        finder->half[2] = EK_R(0.05);
        begin_search(finder);
        ek_work all = ek_work_make(INT64_MAX);
        search(finder, &all);
        if (!found) {
            CHECK(finder->phase == EK_FINDER_IDLE && finder->candidate.outcome == EK_LOOP_SCORE);
            CHECK_NEAR(finder->candidate.number[0], 0.0, 0.0); /* no point lies on the map */
            continue;
        }
        CHECK(finder->phase == (known ? EK_FINDER_INDEX : EK_FINDER_RIVAL)); /* 0.3 m are within the peak */
        CHECK_NEAR(finder->best_score, 1.0, 1e-6);
        CHECK_NEAR(finder->best.x, 0.0, 1e-6);
        CHECK_NEAR(finder->half[0], known ? 0.3 : 7.0, 1e-6);
        CHECK_NEAR(finder->half[2], known ? 0.05 : (double)EK_PI, 1e-6);
    }
    free(arena.memory);
}

int main(void)
{
    keyframes_near_one_are_selected();
    points_are_gathered_in_the_keyframes_frame();
    the_window_holds_three_sigma();
    rivals_are_sought_around_the_best_motion();
    samples_are_taken_evenly();
    phases_follow_each_other();
    the_search_ends_with_a_motion_or_without();
    return verdict();
}

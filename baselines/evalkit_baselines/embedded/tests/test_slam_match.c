/* Matches of the SLAM, each part by hand: samples of a scan, further tries, direct matches; and the scale of the wheels. */
#include "src/slam_match.c"

#include "ek/normals.h"
#include "line.h"

#include <string.h>

#define POINTS 60u

/* Points around the robot: on a circle of 5 m, bulged so that no turn maps it onto itself. */
static ek_pose outline_at(size_t k)
{
    const double angle = 2.0 * (double)EK_PI * (double)k / (double)POINTS, range = 5.0 + 2.0 * cos(angle) + sin(2.0 * angle);
    return pose_of(range * cos(angle), range * sin(angle), 0.0);
}

/* The scan of the outline from a pose; the index of the map holds the outline. */
static void see_outline(ek_pose from)
{
    ek_real target[2u * POINTS];
    for (size_t k = 0; k < POINTS; k++) {
        const ek_pose seen = ek_se2_between(from, outline_at(k));
        target[2u * k] = outline_at(k).x;
        target[2u * k + 1u] = outline_at(k).y;
        slam.scan.hits[2u * k] = seen.x;
        slam.scan.hits[2u * k + 1u] = seen.y;
    }
    slam.scan.count = POINTS;
    memcpy(slam.map_points, target, sizeof target);
    slam.around_drawn = 0;
    CHECK(ek_index_build(&slam.map_index, target, POINTS) == EK_OK);
    CHECK(ek_normals_defer(&slam.map_index, 8u, slam.map_normals) == EK_OK);
}

/* Without pairs each try stays where it began: the heading with most points on the target is taken, of 12 and 24 degrees
 * to either side, and none that is farther off. */
static void the_heading_with_most_points_is_taken(void)
{
    static const double turns_deg[] = {0.0, -12.0, 12.0, -24.0, 24.0, 90.0};
    ek_arena arena = line_of(1u);
    ek_icp_parameters narrow = slam.parameters.matcher;
    narrow.max_correspondence = EK_R(1e-9);
    narrow.min_pairs = 1000;
    for (size_t k = 0; k < 6u; k++) {
        const ek_pose guess = pose_of(0.3, -0.2, 0.4);
        const ek_pose truth = ek_se2_compose(guess, pose_of(0.0, 0.0, turns_deg[k] * (double)EK_PI / 180.0));
        see_outline(truth);
        const ek_pose found = try_starts(&slam, &slam.map_index, guess, NULL, 0, narrow);
        const ek_pose expected = k < 5u ? truth : guess;
        const ek_pose beside = pose_of(0.4, -0.2, 0.4), away = pose_of(-3.0, 2.0, 1.0); /* from `away` the truth is too far */
        CHECK_NEAR(try_starts(&slam, &slam.map_index, beside, &truth, 1, narrow).x, k < 5u ? 0.3 : 0.4, 1e-6);
        CHECK_NEAR(try_starts(&slam, &slam.map_index, away, &truth, 1, narrow).x, -3.0, 0.0);
        CHECK_NEAR(found.x, 0.3, 1e-6);
        CHECK_NEAR(found.y, -0.2, 1e-6);
        CHECK(k == 5u || EK_FABS(found.theta - expected.theta) < EK_R(1e-5));
        CHECK(rate(&slam.map_index, slam.scan.hits, POINTS, truth, 0) == EK_R(POINTS));
        CHECK(rate(&slam.map_index, slam.scan.hits, POINTS, pose_of(50.0, 50.0, 0.0), 0) == EK_R(0.0));
    }
    free(arena.memory);
}

/* A point within 15 cm of the target is near it, whatever its direction. */
static void points_within_15_cm_are_near(void)
{
    static const double off[][3] = {{0.14, 0.0, 1}, {0.0, -0.14, 1}, {0.16, 0.0, 0}, {0.0, 0.16, 0}, {0.11, 0.11, 0}, {0.1, 0.1, 1}};
    const ek_real target[] = {EK_R(3.0), EK_R(4.0), EK_R(9.0), EK_R(9.0)};
    ek_arena arena = line_of(1u);
    CHECK(ek_index_build(&slam.map_index, target, 2u) == EK_OK);
    for (size_t k = 0; k < 6u; k++) {
        const ek_pose pose = pose_of(1.0, -2.0, 0.7), at = pose_of(3.0 + off[k][0], 4.0 + off[k][1], 0.0);
        const ek_pose seen = ek_se2_between(pose, at);
        const ek_real point[] = {seen.x, seen.y};
        CHECK(rate(&slam.map_index, point, 1u, pose, 0) == EK_R(off[k][2]));
    }
    free(arena.memory);
}

/* Without odometry, points on the map count in proportion to how much nearer than 10 cm they are. */
static void closely_a_point_counts_the_more_the_nearer_it_is(void)
{
    static const double off[][3] = {{0.0, 0.0, 1.0}, {0.05, 0.0, 0.5}, {0.0, -0.08, 0.2}, {0.101, 0.0, 0.0}};
    const ek_real target[] = {EK_R(3.0), EK_R(4.0), EK_R(9.0), EK_R(9.0)};
    ek_arena arena = line_of(1u);
    ek_real points[8];
    CHECK(ek_index_build(&slam.map_index, target, 2u) == EK_OK);
    for (size_t k = 0; k < 4u; k++) {
        points[2u * k] = EK_R(3.0 + off[k][0]);
        points[2u * k + 1u] = EK_R(4.0 + off[k][1]);
        CHECK_NEAR(rate(&slam.map_index, points + 2u * k, 1u, ORIGIN, 1), off[k][2], 1e-5);
    }
    CHECK_NEAR(rate(&slam.map_index, points, 4u, ORIGIN, 1), 1.7, 1e-5);
    CHECK_NEAR(rate(&slam.map_index, points, 4u, ORIGIN, 0), 4.0, 0.0);
    free(arena.memory);
}

static void a_try_ends_near_its_guess(void)
{
    static const double cases[][4] = {{0.5, 0.0, 0.0, 1},  {0.0, -0.5, 0.0, 1}, {0.501, 0.0, 0.0, 0},  {0.36, 0.36, 0.0, 0},
                                      {0.0, 0.0, 35.9, 1}, {0.0, 0.0, 36.1, 0}, {0.0, 0.0, -36.1, 0}, {0.35, 0.35, -35.9, 1}};
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        const ek_pose by = pose_of(cases[k][0], cases[k][1], cases[k][2] * (double)EK_PI / 180.0);
        CHECK(is_close(ORIGIN, by) == (int)cases[k][3]);
        CHECK(is_close(ek_se2_inverse(by), ORIGIN) == (int)cases[k][3]);
    }
}

/* Every n-th point, so that at least 20 are left and fewer than 40. */
static void a_part_of_a_scan_is_taken_evenly(void)
{
    static const size_t counts[] = {0u, 1u, 19u, 20u, 39u, 40u, 41u, 59u, 60u}, taken[] = {0u, 1u, 19u, 20u, 39u, 20u, 21u, 30u, 20u};
    ek_arena arena = line_of(1u);
    for (size_t k = 0; k < sizeof counts / sizeof *counts; k++) {
        const size_t every = counts[k] < 40u ? 1u : counts[k] / 20u;
        for (size_t i = 0; i < counts[k]; i++) {
            slam.scan.hits[2u * i] = EK_R(i);
            slam.scan.hits[2u * i + 1u] = EK_R(-3.0 * (double)i);
        }
        slam.scan.count = counts[k];
        CHECK(take_part(&slam, 20u) == taken[k]);
        for (size_t i = 0; i < taken[k]; i++) {
            CHECK_NEAR(slam.moved[2u * i], (double)(i * every), 0.0);
            CHECK_NEAR(slam.moved[2u * i + 1u], -3.0 * (double)(i * every), 0.0);
        }
    }
    ek_icp_parameters parameters = ek_icp_default();
    for (int32_t most = 39; most < 42; most++) {
        parameters.max_iterations = 40;
        limit_iterations(&parameters, most);
        CHECK(parameters.max_iterations == (most < 40 ? most : 40));
    }
    free(arena.memory);
}

/* A match is tried again with fewer than 80 % of the points in pairs. */
static void a_poor_match_is_tried_again(void)
{
    ek_arena arena = line_of(1u);
    ek_match match;
    for (size_t off = 12; off < 14u; off++) { /* 48 of 60 are 80 % */
        see_outline(ORIGIN);
        for (size_t i = 0; i < off; i++) {
            slam.scan.hits[2u * i] += EK_R(30.0);
        }
        slam.tried = 0;
        slam.usual_error = EK_R(0.0);
        CHECK(ek_slam_match(&slam, &slam.map_index, ORIGIN, NULL, 0, &match) == EK_OK);
        CHECK(match.inliers == (int32_t)(POINTS - off) && slam.tried == (off == 13u));
    }
    free(arena.memory);
}

/* Without odometry the map is tried again already from twice the usual error on, with it from four times. */
static void without_odometry_a_doubted_match_with_the_map_is_tried_again(void)
{
    static const double factors[] = {1.9, 2.1, 3.9, 4.1};
    ek_arena arena = line_of(1u);
    ek_match match;
    for (int measured = 0; measured < 2; measured++) {
        for (size_t k = 0; k < 4u; k++) {
            see_outline(ORIGIN);
            for (size_t i = 0; i < POINTS; i++) {
                slam.scan.hits[2u * i] += EK_R(i % 2u ? 0.01 : -0.01);
            }
            slam.usual_error = EK_R(0.0);
            slam.tried = 0;
            CHECK(ek_slam_match(&slam, &slam.map_index, ORIGIN, measured ? NULL : &ORIGIN, 0, &match) == EK_OK && !slam.tried);
            slam.usual_error = match.error / EK_R(factors[k]);
            CHECK(ek_slam_match(&slam, &slam.map_index, ORIGIN, measured ? NULL : &ORIGIN, 0, &match) == EK_OK);
            CHECK(slam.tried == (k > (measured ? 2u : 0u)));
        }
        for (size_t k = 0; k < 2u; k++) { /* above 0.1 m always, however usual that is */
            see_outline(ORIGIN);
            for (size_t i = 0; i < POINTS; i++) {
                slam.scan.hits[2u * i] += EK_R(i % 2u ? 0.3 : -0.3);
            }
            slam.usual_error = EK_R(k ? 10.0 : 0.0);
            slam.tried = 0;
            CHECK(ek_slam_match(&slam, &slam.map_index, ORIGIN, measured ? NULL : &ORIGIN, 0, &match) == EK_OK);
            CHECK(slam.tried);
        }
    }
    free(arena.memory);
}

/* Without odometry the map is tried again where the scan before was, from the prediction and from the guess, if the search of
 * the map does not end. */
static void without_odometry_the_map_is_tried_from_the_prediction(void)
{
    ek_arena arena = line_of(1u);
    ek_match match;
    slam.parameters.matcher.max_correspondence = EK_R(0.01);
    slam.parameters.fine_correspondence = EK_R(1e-9);
    slam.parameters.work = 1; /* too little for the search */
    for (int tried = 0; tried < 2; tried++) {
        for (int by_prediction = 0; by_prediction < 2; by_prediction++) {
            const ek_pose truth = pose_of(0.3, -0.2, 0.4), off = ek_se2_compose(truth, pose_of(0.3, 0.1, 0.25));
            const ek_pose predicted = by_prediction ? truth : off, guess = by_prediction ? off : truth;
            see_outline(truth);
            slam.usual_error = EK_R(0.0);
            slam.tried = tried;
            slam.parameters.matcher.min_pairs = 1000; /* each match ends where it began */
            CHECK(ek_slam_match(&slam, &slam.map_index, guess, &predicted, 0, &match) == EK_OK);
            CHECK(slam.tried == (tried || by_prediction)); /* the truth fits */
            const ek_pose expected = tried || !by_prediction ? truth : off;
            CHECK_NEAR(match.target_from_source.x, expected.x, 1e-5);
            CHECK_NEAR(match.target_from_source.y, expected.y, 1e-5);
        }
    }
    free(arena.memory);
}

/* Without odometry a doubted scan is found 50 deg and 0.7 m from its prediction, farther than any try: on the outline, and not
 * on a circle, where all headings score alike and the match does not fit. Nor is it where the work does not suffice. */
static void without_odometry_a_doubted_scan_is_searched_on_the_map(void)
{
    static const struct {
        int circle;
        int64_t work;
        int found;
    } cases[] = {{0, 0, 1}, {0, 200000, 1}, {1, 0, 0}, {0, 1, 0}};
    for (size_t k = 0; k < sizeof cases / sizeof cases[0]; k++) {
        ek_arena arena = line_of(1u);
        const ek_pose truth = pose_of(0.5, -0.5, 50.0 * (double)EK_PI / 180.0);
        ek_match match;
        see_outline(truth);
        for (size_t i = 0; cases[k].circle && i < POINTS; i++) {
            const double angle = 2.0 * (double)EK_PI * (double)i / (double)POINTS;
            slam.map_points[2u * i] = slam.scan.hits[2u * i] = EK_R(3.0) * (ek_real)cos(angle);
            slam.map_points[2u * i + 1u] = slam.scan.hits[2u * i + 1u] = EK_R(3.0) * (ek_real)sin(angle);
        }
        slam.parameters.work = cases[k].work;
        slam.parameters.matcher.min_pairs = 1000; /* each match ends where it began, and fits where it has pairs */
        CHECK(ek_slam_match(&slam, &slam.map_index, ORIGIN, &ORIGIN, 0, &match) == EK_OK);
        const ek_pose gap = ek_se2_between(match.target_from_source, truth);
        CHECK(cases[k].found == (EK_FABS(gap.x) < EK_R(0.15) && EK_FABS(gap.y) < EK_R(0.15) && EK_FABS(gap.theta) < EK_R(0.05)));
        free(arena.memory);
    }
}

/* The odometry is good where its limit is below half a metre; then a scan is matched from where it puts the robot, unless the
 * answer has pairs for fewer than 80 % of the points, more than twice the usual error, or is more than three times as far away as
 * usual, which is at least 1 cm and 5 % of the step. */
static void a_scan_is_matched_directly_where_nothing_is_doubted(void)
{
    static const struct {
        double x, y, usual_gap, usual_error;
        size_t off, least; /* points without a pair, and pairs that are asked for */
        int direct;
    } cases[] = {{0.0, 0.028, 0.0, 0.01, 0, 10, 1},  {0.0, 0.05, 0.0, 0.01, 0, 10, 0},   {0.0, 0.05, 0.02, 0.01, 0, 10, 1},
                 {0.4, 0.05, 0.0, 0.01, 0, 10, 1},  {0.4, 0.08, 0.0, 0.01, 0, 10, 1},   {0.4, 0.1, 0.0, 0.01, 0, 10, 0},
                 {0.0, 0.028, 0.0, 0.01, 12, 10, 1}, {0.0, 0.028, 0.0, 0.01, 13, 10, 0},  {0.0, 0.028, 0.0, 0.01, 0, 60, 1},
                 {0.0, 0.028, 0.0, 0.01, 0, 61, 0},  {0.0, 0.028, 0.0, 0.0001, 0, 10, 0}, {0.0, 0.028, 0.0, 0.01, 60, 10, 0}};
    ek_arena arena = line_of(1u);
    slam.closed = 1;
    slam.compared = 50u;
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        const ek_pose truth = pose_of(1.0, 2.0, 0.3), guess = ek_se2_compose(truth, pose_of(0.0, cases[k].y, 0.0));
        ek_pose pose = guess;
        ek_match match;
        see_outline(truth);
        for (size_t i = 0; i < POINTS; i++) { /* 3 mm of noise; the last points lie nowhere */
            slam.scan.hits[2u * i] += EK_R(i % 2u ? 0.003 : -0.003) + EK_R(i < POINTS - cases[k].off ? 0.0 : 90.0);
        }
        slam.motion.start_from_base = ek_se2_compose(guess, pose_of(-cases[k].x, 0.0, 0.0));
        slam.usual_gap = EK_R(cases[k].usual_gap);
        slam.usual_error = EK_R(cases[k].usual_error);
        slam.gate = ek_slam_gate(&slam, 1, pose_of(cases[k].x, 0.0, 0.0));
        slam.parameters.min_inliers = (int32_t)cases[k].least;
        CHECK(ek_slam_match_directly(&slam, &pose, &match) == cases[k].direct && match.iterations <= 5);
        CHECK_NEAR(pose.x, cases[k].direct ? truth.x : guess.x, cases[k].direct ? 4e-3 : 0.0);
        CHECK_NEAR(pose.y, cases[k].direct ? truth.y : guess.y, cases[k].direct ? 4e-3 : 0.0);
    }
    slam.scan.count = 0u;
    ek_pose pose = ORIGIN;
    ek_match match;
    CHECK(!ek_slam_match_directly(&slam, &pose, &match));
    for (int measured = 0; measured < 2; measured++) { /* unknown; 1 cm: 0.3 m; 3 cm: 0.5 m */
        static const double usual[] = {0.01, 0.01, 0.03};
        for (size_t k = 0; k < 3u; k++) {
            slam.compared = k ? 50u : 49u;
            slam.usual_gap = EK_R(usual[k]);
            const ek_gate gate = ek_slam_gate(&slam, measured, ORIGIN);
            CHECK(ek_slam_is_good(&gate) == (measured && k == 1u));
        }
    }
    free(arena.memory);
}

/* The motion of the wheels is compared along its own direction, and not across it, where a step is at least 0.1 m long and
 * differs by at most a tenth. */
static void steps_count_along_the_motion_of_the_wheels(void)
{
    static const struct {
        double x, y, wheels, along;
        int counts;
    } cases[] = {{0.6, 0.8, 1.0, 1.0, 1},     {0.5, 0.8, 1.0, 0.94, 1},   {-0.2, 1.4, 1.0, 1.0, 1},  {0.6, 0.66, 1.0, 0.888, 0},
                 {0.6, 0.69, 1.0, 0.912, 1},  {0.66, 0.87, 1.0, 1.092, 1}, {0.66, 0.89, 1.0, 1.108, 0},
                 {0.06, 0.08, 0.1001, 0.1, 1}, {0.06, 0.08, 0.0999, 0.1, 0}};
    ek_arena arena = line_of(1u);
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        slam.wheels.has_last = slam.wheels.has_keyframe = slam.wheels.seen = 1;
        slam.wheels.matched = slam.wheels.driven = EK_R(5.0);
        slam.wheels.keyframe = pose_of(3.0, 4.0, 0.5);
        slam.wheels.now = ek_se2_compose(slam.wheels.keyframe, pose_of(0.6 * cases[k].wheels, 0.8 * cases[k].wheels, 0.3));
        ek_slam_observe_wheels(&slam, pose_of(cases[k].x, cases[k].y, 0.1), &CLOSED, 1);
        CHECK_NEAR(slam.wheels.matched, 5.0 + (cases[k].counts ? cases[k].along : 0.0), 1e-5);
        CHECK_NEAR(slam.wheels.driven, 5.0 + (cases[k].counts ? cases[k].wheels : 0.0), 1e-5);
        CHECK_NEAR(slam.wheels.keyframe.x, slam.wheels.now.x, 0.0);
    }
    const ek_openness seen = {.x = EK_R(1.0), .ratio = EK_R(0.0651)}, open = {.x = EK_R(1.0), .ratio = EK_R(0.0649)};
    ek_slam_observe_wheels(&slam, ORIGIN, &seen, 1);
    CHECK(slam.wheels.seen);
    ek_slam_observe_wheels(&slam, ORIGIN, &open, 1);
    CHECK(!slam.wheels.seen);
    free(arena.memory);
}

int main(void)
{
    the_heading_with_most_points_is_taken();
    points_within_15_cm_are_near();
    closely_a_point_counts_the_more_the_nearer_it_is();
    a_try_ends_near_its_guess();
    a_part_of_a_scan_is_taken_evenly();
    a_poor_match_is_tried_again();
    without_odometry_a_doubted_match_with_the_map_is_tried_again();
    without_odometry_the_map_is_tried_from_the_prediction();
    without_odometry_a_doubted_scan_is_searched_on_the_map();
    a_scan_is_matched_directly_where_nothing_is_doubted();
    steps_count_along_the_motion_of_the_wheels();
    return verdict();
}

#include "check.h"
#include "ek/pose_graph.h"

#define POSES 64u
#define LOOPS 12u

static ek_pose_graph graph;

static const ek_sym3 UNIT = {EK_R(1.0), EK_R(0.0), EK_R(0.0), EK_R(1.0), EK_R(0.0), EK_R(1.0)};
static const ek_sym3 SHARP = {EK_R(100.0), EK_R(0.0), EK_R(0.0), EK_R(100.0), EK_R(0.0), EK_R(400.0)};

static ek_pose pose_of(double x, double y, double theta)
{
    const ek_pose pose = {EK_R(x), EK_R(y), EK_R(theta)};
    return pose;
}

static ek_loop_edge loop_of(uint32_t first, uint32_t second, ek_pose motion, const ek_sym3 *information)
{
    const ek_loop_edge loop = {first, second, motion, *information, EK_R(1.0)};
    return loop;
}

static int64_t run(const ek_solver_settings *settings, int64_t slice)
{
    int64_t slices = 1;
    CHECK(ek_pose_graph_begin(&graph, settings, 1) == EK_OK);
    ek_work work = ek_work_make(slice);
    for (; !ek_pose_graph_work(&graph, &work); slices++) {
        work = ek_work_make(slice);
    }
    ek_pose_graph_commit(&graph);
    return slices;
}

/* A drive around a square of 4 m in steps of 1 m: the true poses. */
static ek_pose place(size_t k)
{
    static const double x[] = {0, 1, 2, 3, 4, 4, 4, 4, 4, 3, 2, 1, 0, 0, 0, 0};
    static const double y[] = {0, 0, 0, 0, 0, 1, 2, 3, 4, 4, 4, 4, 4, 3, 2, 1};
    return pose_of(x[k % 16u], y[k % 16u], (double)ek_se2_wrap(EK_R(0.5) * EK_PI * (ek_real)(k % 16u / 4u)));
}

static void drive(size_t poses, double noise, uint64_t *seed)
{
    ek_pose_graph_reset(&graph);
    for (size_t k = 0; k < poses; k++) {
        ek_pose step = k ? ek_se2_between(place(k - 1u), place(k)) : pose_of(0, 0, 0);
        step.x += uniform(seed, -noise, noise);
        step.y += uniform(seed, -noise, noise);
        step.theta += uniform(seed, -noise, noise);
        CHECK(ek_pose_graph_add(&graph, step, &SHARP) == EK_OK);
    }
}

/* Steps of 1 m and a loop of 3.6 m over four of them, all with the same information: each edge takes a fifth of 0.4 m. */
static void a_straight_line_shares_the_gap_of_its_loop(void)
{
    const ek_solver_settings settings = {10, EK_R(1e-9), EK_R(0.0)};
    const ek_loop_edge loop = loop_of(0u, 4u, pose_of(3.6, 0.0, 0.0), &UNIT);
    ek_pose_graph_reset(&graph);
    for (size_t k = 0; k < 6u; k++) {
        CHECK(ek_pose_graph_add(&graph, pose_of(1.0, 0.0, 0.0), &UNIT) == EK_OK);
    }
    CHECK(ek_pose_graph_close(&graph, &loop) == EK_OK);
    CHECK_NEAR(ek_pose_graph_chi(graph.loop, graph.pose), 0.16, TOLERANCE);
    run(&settings, INT64_MAX);
    CHECK(graph.solver.converged && graph.solver.iterations <= 2);
    CHECK_NEAR(graph.solver.chi_square, 5.0 * 0.08 * 0.08, TOLERANCE);
    for (size_t k = 0; k < 6u; k++) {
        CHECK_NEAR(graph.pose[k].x, k < 5u ? 0.92 * (double)k : 0.92 * 4.0 + 1.0, TOLERANCE);
        CHECK_NEAR(graph.pose[k].y, 0.0, TOLERANCE);
    }
}

/* Covariance of two steps of variance 1 in x, y and theta in the frame of the last pose, 1 m farther each: the first
 * step's turn moves the end by 1 m a radian, so y has 1 + 1 + 1, and y and theta share 1. With a loop across both of
 * variance 3, 3, 2 (uncorrelated) the update of Kalman gives the rest. */
static void the_predicted_covariance_is_that_of_a_hand_calculation(void)
{
    const ek_sym3 third = {EK_R(1.0) / EK_R(3.0), EK_R(0.0), EK_R(0.0), EK_R(1.0) / EK_R(3.0), EK_R(0.0), EK_R(0.5)};
    const ek_loop_edge loop = loop_of(0u, 2u, pose_of(2.0, 0.0, 0.0), &third);
    ek_work work = ek_work_make(INT64_MAX);
    ek_pose_graph_reset(&graph);
    for (size_t k = 0; k < 3u; k++) {
        CHECK(ek_pose_graph_add(&graph, pose_of(1.0, 0.0, 0.0), &UNIT) == EK_OK);
    }
    CHECK(ek_pose_graph_predict(&graph, 0u, 2u) == EK_OK && ek_pose_graph_work(&graph, &work));
    CHECK_NEAR(graph.solver.predicted.xx, 2.0, TOLERANCE);
    CHECK_NEAR(graph.solver.predicted.yy, 3.0, TOLERANCE);
    CHECK_NEAR(graph.solver.predicted.yt, 1.0, TOLERANCE);
    CHECK_NEAR(graph.solver.predicted.tt, 2.0, TOLERANCE);
    CHECK_NEAR(graph.solver.predicted.xy, 0.0, TOLERANCE);
    CHECK(ek_pose_graph_close(&graph, &loop) == EK_OK);
    CHECK(ek_pose_graph_predict(&graph, 0u, 2u) == EK_OK && ek_pose_graph_work(&graph, &work));
    CHECK_NEAR(graph.solver.predicted.xx, 2.0 * 3.0 / 5.0, TOLERANCE);
    /* inverse of [[3, 1], [1, 2]]^-1 + diag(1/3, 1/2) = [[0.4 + 1/3, -0.2], [-0.2, 0.6 + 1/2]] */
    const double a = 0.4 + 1.0 / 3.0, b = -0.2, d = 1.1, determinant = a * d - b * b;
    CHECK_NEAR(graph.solver.predicted.yy, d / determinant, TOLERANCE);
    CHECK_NEAR(graph.solver.predicted.yt, -b / determinant, TOLERANCE);
    CHECK_NEAR(graph.solver.predicted.tt, a / determinant, TOLERANCE);
}

/* The covariance between two poses of a winding drive: that of each step, carried by the motion from its end to the second
 * pose, where a turn of a step moves what lies ahead of it. */
static void the_predicted_covariance_is_carried_along_the_drive(uint64_t *seed)
{
    static const uint32_t ends[][2] = {{0u, 1u}, {0u, 9u}, {3u, 7u}, {8u, 9u}};
    ek_sym3 spread[10];
    ek_pose_graph_reset(&graph);
    for (size_t k = 0; k < 10u; k++) {
        const ek_pose step = {uniform(seed, 0.5, 1.5), uniform(seed, -1.0, 1.0), uniform(seed, -1.2, 1.2)};
        const ek_real a = uniform(seed, 0.1, 0.2), b = uniform(seed, 0.1, 0.2), c = uniform(seed, 0.01, 0.03);
        const ek_sym3 covariance = {a, EK_R(0.3) * a, EK_R(0.1) * c, b, EK_R(-0.2) * c, c};
        ek_sym3 information;
        spread[k] = covariance;
        CHECK(ek_sym3_inverse(&covariance, &information) && ek_pose_graph_add(&graph, step, &information) == EK_OK);
    }
    for (size_t e = 0; e < sizeof ends / sizeof *ends; e++) {
        ek_sym3 sum = {EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(0.0)};
        for (size_t k = ends[e][0] + 1u; k <= ends[e][1]; k++) {
            const ek_pose on = ek_se2_between(graph.pose[k], graph.pose[ends[e][1]]);
            const ek_real c = EK_COS(on.theta), s = EK_SIN(on.theta);
            const ek_real carry[9] = {c, s, s * on.x - c * on.y, -s, c, s * on.y + c * on.x, EK_R(0.0), EK_R(0.0), EK_R(1.0)};
            const ek_sym3 one = ek_sym3_congruence(carry, spread + k);
            sum = ek_sym3_sum(&sum, &one, EK_R(1.0));
        }
        ek_work work = ek_work_make(INT64_MAX);
        CHECK(ek_pose_graph_predict(&graph, ends[e][0], ends[e][1]) == EK_OK && ek_pose_graph_work(&graph, &work));
        const ek_sym3 *const found = &graph.solver.predicted;
        const ek_real all[] = {found->xx, found->xy, found->xt, found->yy, found->yt, found->tt};
        const ek_real expected[] = {sum.xx, sum.xy, sum.xt, sum.yy, sum.yt, sum.tt};
        for (size_t k = 0; k < 6u; k++) {
            CHECK_NEAR(all[k], expected[k], 100.0 * TOLERANCE);
        }
    }
}

static void exact_loops_recover_a_disturbed_drive(uint64_t *seed)
{
    static const uint32_t ends[][2] = {{0u, 1u}, {0u, 16u}, {3u, 19u}, {1u, 30u}, {7u, 23u}, {16u, 31u}};
    const ek_solver_settings settings = {20, EK_R(1e-9), EK_R(0.0)};
    const ek_sym3 exact = {EK_R(1e4), EK_R(0.0), EK_R(0.0), EK_R(1e4), EK_R(0.0), EK_R(1e4)};
    drive(32u, 0.0, seed);
    for (size_t l = 0; l < sizeof ends / sizeof *ends; l++) {
        const ek_loop_edge loop =
            loop_of(ends[l][0], ends[l][1], ek_se2_between(place(ends[l][0]), place(ends[l][1])), &exact);
        CHECK(ek_pose_graph_close(&graph, &loop) == EK_OK);
    }
    for (size_t k = 1; k < 32u; k++) { /* the start is disturbed, not the measurements */
        graph.pose[k].x += uniform(seed, -0.1, 0.1);
        graph.pose[k].theta += uniform(seed, -0.1, 0.1);
    }
    run(&settings, INT64_MAX);
    for (size_t k = 0; k < 32u; k++) {
        const ek_pose gap = ek_se2_between(place(k), graph.pose[k]);
        CHECK_NEAR(gap.x, 0.0, 50.0 * TOLERANCE);
        CHECK_NEAR(gap.y, 0.0, 50.0 * TOLERANCE);
        CHECK_NEAR(gap.theta, 0.0, 50.0 * TOLERANCE);
    }
}

/* At the optimum no small move of any pose lowers the sum of chi-squares. */
static double cost(void)
{
    double sum = 0.0;
    for (uint32_t k = 1; k < graph.count; k++) {
        const ek_loop_edge step = loop_of(k - 1u, k, graph.step[k].last_from_pose, &graph.step[k].information);
        sum += (double)ek_pose_graph_chi(&step, graph.pose);
    }
    for (size_t l = 0; l < graph.loop_count; l++) {
        sum += (double)ek_pose_graph_chi(graph.loop + l, graph.pose);
    }
    return sum;
}

static void noisy_loops(uint64_t *seed)
{
    for (uint32_t l = 0; l < 10u; l++) {
        const uint32_t first = l, second = 17u + 2u * l;
        ek_pose motion = ek_se2_between(place(first), place(second));
        motion.x += uniform(seed, -0.1, 0.1);
        motion.theta += uniform(seed, -0.05, 0.05);
        const ek_loop_edge loop = loop_of(first, second, motion, &SHARP);
        CHECK(ek_pose_graph_close(&graph, &loop) == EK_OK);
    }
}

static void no_small_move_improves_the_optimum(uint64_t *seed)
{
    const ek_solver_settings settings = {20, EK_R(1e-12), EK_R(0.0)};
    drive(40u, 0.02, seed);
    noisy_loops(seed);
    const double before = cost();
    run(&settings, INT64_MAX);
    const double least = cost();
    CHECK_NEAR(graph.solver.chi_square, least, 1e4 * TOLERANCE);
    CHECK(least < 0.2 * before);
    for (size_t k = 1; k < graph.count; k++) {
        for (size_t axis = 0; axis < 6u; axis++) {
            ek_real *const number = &graph.pose[k].x + axis / 2u, kept = *number;
            *number += axis % 2u ? EK_R(3e-3) : EK_R(-3e-3);
            CHECK(cost() > least);
            *number = kept;
        }
    }
}

/* Where all errors are small the problem is linear: one iteration moves each pose to its optimum. */
static void one_iteration_is_enough_for_small_errors(uint64_t *seed)
{
    const ek_solver_settings one = {1, EK_R(1e-12), EK_R(0.0)}, many = {20, EK_R(1e-12), EK_R(0.0)};
    ek_pose first[40], odometry[40];
    drive(40u, 1e-4, seed);
    for (uint32_t l = 0; l < 10u; l++) {
        const ek_loop_edge loop = loop_of(l, 17u + 2u * l, ek_se2_between(place(l), place(17u + 2u * l)), &SHARP);
        CHECK(ek_pose_graph_close(&graph, &loop) == EK_OK);
    }
    memcpy(odometry, graph.pose, sizeof odometry);
    run(&one, INT64_MAX);
    CHECK(graph.solver.iterations == 1);
    memcpy(first, graph.pose, sizeof first);
    run(&many, INT64_MAX);
    double moved = 0.0;
    for (size_t k = 0; k < 40u; k++) {
        CHECK_NEAR(first[k].x, graph.pose[k].x, 5e-6 + 2.0 * TOLERANCE);
        CHECK_NEAR(first[k].y, graph.pose[k].y, 5e-6 + 2.0 * TOLERANCE);
        CHECK_NEAR(first[k].theta, graph.pose[k].theta, 5e-6 + 2.0 * TOLERANCE);
        moved += (double)EK_FABS(first[k].x - odometry[k].x) / 40.0;
    }
    CHECK(moved > 2e-4);
}

static void slices_change_no_bit_and_stay_within_their_work(uint64_t *seed)
{
    const ek_solver_settings settings = {6, EK_R(1e-9), EK_R(10.0)};
    ek_pose whole[POSES];
    const uint64_t start = *seed;
    drive(40u, 0.02, seed);
    noisy_loops(seed);
    CHECK(run(&settings, INT64_MAX) == 1);
    memcpy(whole, graph.pose, 40u * sizeof *whole);
    *seed = start;
    drive(40u, 0.02, seed);
    noisy_loops(seed);
    CHECK(ek_pose_graph_begin(&graph, &settings, 1) == EK_OK);
    for (int done = 0; !done;) {
        ek_work work = ek_work_make(20);
        done = ek_pose_graph_work(&graph, &work);
        CHECK(work.done <= 20u + 12u * 10u + 1u); /* the loops are weighed in one part */
        if (graph.count < 50u) { /* the drive goes on meanwhile */
            CHECK(ek_pose_graph_add(&graph, pose_of(1.0, 0.0, 0.1), &SHARP) == EK_OK);
        }
    }
    const ek_pose tail = ek_se2_between(graph.pose[39], graph.pose[49]);
    ek_pose_graph_commit(&graph);
    CHECK(memcmp(whole, graph.pose, 40u * sizeof *whole) == 0);
    const ek_pose moved = ek_se2_between(graph.pose[39], graph.pose[49]);
    CHECK_NEAR(moved.x, tail.x, 50.0 * TOLERANCE);
    CHECK_NEAR(moved.theta, tail.theta, 50.0 * TOLERANCE);
}

/* Operations of a run of one iteration over 9 poses and 3 loops: 12 a step or loop, 12 a block of the first column, 3 more
 * for each column further, one a row of either substitution. */
static void the_work_of_a_run_is_that_of_a_hand_calculation(void)
{
    const ek_solver_settings one = {1, EK_R(0.0), EK_R(0.0)};
    ek_work work = ek_work_make(INT64_MAX);
    ek_pose_graph_reset(&graph);
    for (size_t k = 0; k < 9u; k++) {
        CHECK(ek_pose_graph_add(&graph, pose_of(1.0, 0.0, 0.1), &UNIT) == EK_OK);
    }
    for (uint32_t l = 0; l < 3u; l++) {
        const ek_loop_edge loop = loop_of(l, 8u, pose_of(5.0, 1.0, 0.5), &UNIT);
        CHECK(ek_pose_graph_close(&graph, &loop) == EK_OK);
    }
    CHECK(ek_pose_graph_begin(&graph, &one, 1) == EK_OK && ek_pose_graph_work(&graph, &work));
    const uint64_t chain = 8u * 12u, loops = 3u * 12u + 1u, blocks = 12u + (12u + 15u) + (12u + 15u + 18u), rows = 1u + 2u + 3u;
    CHECK(work.done == 2u * (chain + loops) + blocks + 2u * rows + (9u + 3u) + chain);
}

static void a_false_loop_loses_its_weight(uint64_t *seed)
{
    const ek_solver_settings settings = {30, EK_R(1e-9), EK_R(10.0)};
    const ek_loop_edge lie = loop_of(2u, 25u, pose_of(5.0, -3.0, 1.0), &SHARP);
    drive(40u, 0.0, seed);
    noisy_loops(seed);
    CHECK(ek_pose_graph_close(&graph, &lie) == EK_OK);
    run(&settings, INT64_MAX);
    CHECK(graph.loop[10].weight < EK_R(1e-3));
    for (size_t l = 0; l < 10u; l++) {
        CHECK(graph.loop[l].weight > EK_R(0.9));
    }
}

/* The same loop twice, 10^30 times as certain as the step: no number holds their difference, and nothing moves. */
static void loops_that_cannot_be_told_apart_are_singular(void)
{
    const ek_solver_settings settings = {5, EK_R(0.0), EK_R(0.0)};
    const ek_sym3 certain = {EK_R(1e15), EK_R(0.0), EK_R(0.0), EK_R(1e15), EK_R(0.0), EK_R(1e15)};
    const ek_sym3 vague = {EK_R(1e-15), EK_R(0.0), EK_R(0.0), EK_R(1e-15), EK_R(0.0), EK_R(1e-15)};
    const ek_loop_edge loop = loop_of(0u, 1u, pose_of(1.5, 0.0, 0.0), &certain);
    ek_pose_graph_reset(&graph);
    CHECK(ek_pose_graph_add(&graph, pose_of(0.0, 0.0, 0.0), &vague) == EK_OK);
    CHECK(ek_pose_graph_add(&graph, pose_of(1.0, 0.0, 0.0), &vague) == EK_OK);
    CHECK(ek_pose_graph_close(&graph, &loop) == EK_OK && ek_pose_graph_close(&graph, &loop) == EK_OK);
    run(&settings, INT64_MAX);
    CHECK(graph.solver.singular && !graph.solver.converged);
    CHECK_NEAR(graph.pose[1].x, 1.0, 0.0);
    graph.loop[0].weight = graph.loop[1].weight = EK_R(0.0); /* without weight they do not take part */
    run(&settings, INT64_MAX);
    CHECK(!graph.solver.singular && graph.solver.active == 0u);
    CHECK_NEAR(graph.pose[1].x, 1.0, 0.0);
}

/* Positive definite is what has a factor: each leading part that is not positive is refused. */
static void only_positive_definite_matrices_have_an_inverse(void)
{
    static const double none[][6] = {{0, 0, 0, 1, 0, 1}, {-1, 0, 0, 1, 0, 1}, {1, 2, 0, 1, 0, 1}, {1, 0, 0, 0, 0, 1},
                                     {1, 0, 2, 1, 0, 1}, {1, 0, 0, 1, 2, 1},  {1, 0, 0, 1, 0, 0}, {1, 0, 0, 1, 0, (double)INFINITY}};
    ek_sym3 inverse = UNIT;
    for (size_t k = 0; k < sizeof none / sizeof *none; k++) {
        const double *const m = none[k];
        const ek_sym3 matrix = {EK_R(m[0]), EK_R(m[1]), EK_R(m[2]), EK_R(m[3]), EK_R(m[4]), EK_R(m[5])};
        CHECK(!ek_sym3_inverse(&matrix, &inverse) && memcmp(&inverse, &UNIT, sizeof inverse) == 0);
    }
}

static void check_matrix(ek_sym3 found, const double expected[6])
{
    const ek_real all[] = {found.xx, found.xy, found.xt, found.yy, found.yt, found.tt};
    for (size_t k = 0; k < 6u; k++) {
        CHECK_NEAR(all[k], expected[k], TOLERANCE);
    }
}

/* Products of whole numbers, and an inverse by its minors: its determinant is 67. */
static void matrices_are_those_of_hand_calculations(void)
{
    const ek_sym3 a = {EK_R(2.0), EK_R(3.0), EK_R(5.0), EK_R(7.0), EK_R(11.0), EK_R(13.0)};
    const ek_sym3 positive = {EK_R(4.0), EK_R(2.0), EK_R(1.0), EK_R(5.0), EK_R(3.0), EK_R(6.0)};
    const ek_real v[] = {EK_R(1.0), EK_R(-2.0), EK_R(3.0)};
    const ek_real b[] = {EK_R(1.0), EK_R(2.0), EK_R(3.0), EK_R(-1.0), EK_R(1.0), EK_R(2.0), EK_R(4.0), EK_R(-2.0), EK_R(1.0)};
    static const double congruent[] = {321, 159, 58, 79, 24, 21}, sum[] = {4, 4, 5.5, 9.5, 12.5, 16};
    static const double inverted[] = {21.0 / 67, -9.0 / 67, 1.0 / 67, 23.0 / 67, -10.0 / 67, 16.0 / 67};
    ek_sym3 inverse = UNIT;
    CHECK_NEAR(ek_sym3_quadratic(&a, v), 33.0, 0.0); /* (1, -2, 3) times (11, 22, 22) */
    check_matrix(ek_sym3_congruence(b, &a), congruent);
    check_matrix(ek_sym3_sum(&a, &positive, EK_R(0.5)), sum);
    CHECK(ek_sym3_inverse(&positive, &inverse));
    check_matrix(inverse, inverted);
}

static void bad_input_is_named_and_changes_nothing(void)
{
    const ek_solver_settings none = {0, EK_R(0.0), EK_R(0.0)};
    const ek_sym3 flat = {EK_R(1.0), EK_R(1.0), EK_R(0.0), EK_R(1.0), EK_R(0.0), EK_R(1.0)};
    ek_loop_edge loop = loop_of(3u, 3u, pose_of(0, 0, 0), &UNIT);
    ek_arena measured = ek_arena_make(NULL, 0u);
    ek_pose_graph unused;
    const size_t count = graph.count, loops = graph.loop_count;
    CHECK(ek_pose_graph_close(&graph, &loop) == EK_OUT_OF_RANGE);
    loop.second = (uint32_t)count;
    CHECK(ek_pose_graph_close(&graph, &loop) == EK_OUT_OF_RANGE);
    loop.second = 4u;
    loop.first_from_second.y = (ek_real)NAN;
    CHECK(ek_pose_graph_close(&graph, &loop) == EK_NOT_FINITE);
    CHECK(ek_pose_graph_add(&graph, pose_of(0, 0, 0), &flat) == EK_OUT_OF_RANGE);
    CHECK(ek_pose_graph_add(&graph, pose_of(1e7, 0, 0), &UNIT) == EK_OUT_OF_RANGE);
    CHECK(ek_pose_graph_add(&graph, pose_of(0, 0, 0), NULL) == EK_NULL_POINTER);
    CHECK(ek_pose_graph_begin(&graph, &none, 1) == EK_OUT_OF_RANGE);
    CHECK(ek_pose_graph_predict(&graph, 5u, 5u) == EK_OUT_OF_RANGE);
    CHECK(graph.count == count && graph.loop_count == loops);
    ek_pose_graph_reset(&graph); /* nothing leads to the first pose: what is said of it does not matter */
    CHECK(ek_pose_graph_add(&graph, pose_of(1e7, 0, 0), &flat) == EK_OK && EK_FABS(graph.pose[0].x) <= EK_R(0.0));
    CHECK(ek_pose_graph_init(&unused, &measured, 0u, 1u) == EK_OUT_OF_RANGE);
    CHECK(ek_pose_graph_init(&unused, &measured, 1u, 1025u) == EK_OUT_OF_RANGE);
    while (graph.count < POSES) {
        CHECK(ek_pose_graph_add(&graph, pose_of(0, 0, 0), &UNIT) == EK_OK);
    }
    CHECK(ek_pose_graph_add(&graph, pose_of(0, 0, 0), &UNIT) == EK_TOO_MANY_POINTS);
}

int main(void)
{
    ek_arena measured = ek_arena_make(NULL, 0u);
    uint64_t seed = 5u;
    CHECK(ek_pose_graph_init(&graph, &measured, POSES, LOOPS) == EK_OK);
    ek_arena arena = memory_of(measured.used);
    CHECK(ek_pose_graph_init(&graph, &arena, POSES, LOOPS) == EK_OK && ek_arena_check(&arena) == EK_OK);
    CHECK(ek_pose_graph_add(&graph, pose_of(0.0, 0.0, 0.0), &UNIT) == EK_OK);
    ek_pose_graph_commit(&graph); /* of no run: nothing */
    CHECK(graph.count == 1u && graph.pose[0].x >= EK_R(0.0) && graph.pose[0].x <= EK_R(0.0));
    a_straight_line_shares_the_gap_of_its_loop();
    the_predicted_covariance_is_that_of_a_hand_calculation();
    the_predicted_covariance_is_carried_along_the_drive(&seed);
    exact_loops_recover_a_disturbed_drive(&seed);
    no_small_move_improves_the_optimum(&seed);
    one_iteration_is_enough_for_small_errors(&seed);
    slices_change_no_bit_and_stay_within_their_work(&seed);
    loops_that_cannot_be_told_apart_are_singular();
    only_positive_definite_matrices_have_an_inverse();
    matrices_are_those_of_hand_calculations();
    the_work_of_a_run_is_that_of_a_hand_calculation();
    a_false_loop_loses_its_weight(&seed);
    bad_input_is_named_and_changes_nothing();
    free(arena.memory);
    return verdict();
}

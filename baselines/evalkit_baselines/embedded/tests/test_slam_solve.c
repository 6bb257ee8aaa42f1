/* Which loops are kept: weights, rounds and what follows from them, each on both sides of its bound. */
#include "src/slam_solve.c"

#include "line.h"

/* Close a loop between keyframes 0 and `second` that is `gap` m too long, with information 1 and a record of its own. */
static void close_loop(uint32_t second, double gap)
{
    ek_pose_graph *const graph = &slam.keyframes.graph;
    const ek_loop_edge edge = edge_of(0u, second, pose_of((double)second + gap, 0.0, 0.0), 1.0);
    ek_loop_record *const record = slam.record + slam.record_count;
    memset(record, 0, sizeof *record);
    record->accepted = 1;
    slam.record_of_loop[graph->loop_count] = (uint32_t)slam.record_count++;
    CHECK(ek_pose_graph_close(graph, &edge) == EK_OK);
}

/* As if the solver had moved nothing. */
static void solved(void)
{
    ek_pose_graph *const graph = &slam.keyframes.graph;
    memcpy(graph->moved, graph->pose, graph->count * sizeof *graph->moved);
    graph->solver.nodes = graph->count;
    graph->solver.phase = EK_SOLVER_IDLE;
}

/* Truncated least squares, graduated by mu: with the square r of a residual, its limit c and a = mu / (mu + 1) the weight
 * is 1 up to a c, 0 from c / a on, and sqrt(c mu (mu + 1) / r) - mu between. */
static void weights_follow_chi_square_and_mu(void)
{
    static const double mus[] = {0.1, 1.0, 10.0}, shares[] = {0.0, 0.05, 0.2, 0.499, 0.6, 0.95, 1.0, 1.05, 1.9, 2.1, 30.0};
    for (size_t m = 0; m < 3u; m++) {
        for (size_t k = 0; k < sizeof shares / sizeof *shares; k++) {
            ek_arena arena = line_of(4u);
            const double mu = mus[m], share = shares[k];
            const double between = sqrt(mu * (mu + 1.0) / (share > 0.0 ? share : 1e-9)) - mu;
            const double expected = share <= mu / (mu + 1.0) ? 1.0 : share >= (mu + 1.0) / mu ? 0.0 : between;
            close_loop(3u, sqrt(share * 11.345));
            solved();
            CHECK(truncate_weights(&slam.keyframes.graph, EK_R(mu)) == (expected > 0.0 && expected < 1.0));
            CHECK_NEAR(slam.keyframes.graph.loop[0].weight, expected, 1e-5);
            CHECK_NEAR(largest_chi(&slam.keyframes.graph), share * 11.345, 1e-4 * (1.0 + share));
            free(arena.memory);
        }
    }
    ek_arena arena = line_of(4u); /* of several loops one that is undecided is enough */
    close_loop(3u, sqrt(11.345));
    close_loop(2u, 0.0);
    close_loop(1u, 100.0);
    solved();
    CHECK(truncate_weights(&slam.keyframes.graph, EK_R(1.0)));
    CHECK_NEAR(slam.keyframes.graph.loop[0].weight, sqrt(2.0) - 1.0, 1e-5);
    CHECK_NEAR(slam.keyframes.graph.loop[1].weight, 1.0, 0.0);
    CHECK_NEAR(slam.keyframes.graph.loop[2].weight, 0.0, 0.0);
    CHECK_NEAR(largest_chi(&slam.keyframes.graph), 1e4, 1e-2);
    free(arena.memory);
}

static void loops_up_to_half_a_weight_are_withdrawn(void)
{
    static const double weights[LINE_LOOPS] = {0.5, 0.501, 0.0, 1.0};
    ek_arena arena = line_of(6u);
    for (uint32_t l = 0; l < LINE_LOOPS; l++) {
        close_loop(l + 1u, 0.0);
        slam.keyframes.graph.loop[l].weight = EK_R(weights[l]);
    }
    withdraw(&slam);
    CHECK(slam.keyframes.graph.loop_count == 2u && slam.record_of_loop[0] == 1u && slam.record_of_loop[1] == 3u);
    CHECK(slam.keyframes.graph.loop[0].second == 2u && slam.keyframes.graph.loop[1].second == 4u);
    for (size_t l = 0; l < LINE_LOOPS; l++) {
        CHECK(slam.record[l].accepted == (int)(l % 2u) && slam.record[l].withdrawn == (int)(1u - l % 2u));
    }
    free(arena.memory);
}

/* A correction moves some keyframe but the last by more than 1 cm or half a degree. */
static void small_moves_are_no_corrections(void)
{
    const double turn = 0.5 * (double)EK_PI / 180.0;
    const struct {
        double x, y, theta;
        int corrects;
    } cases[] = {{0.0, 0.0, 0.0, 0},   {0.01, 0.0, 0.0, 0},   {0.0, -0.01, 0.0, 0}, {0.0101, 0.0, 0.0, 1},
                 {0.0, 0.0101, 0.0, 1}, {0.008, 0.008, 0.0, 1}, {0.007, -0.007, 0.0, 0},
                 {0.0, 0.0, 0.999 * turn, 0}, {0.0, 0.0, -1.001 * turn, 1}};
    ek_arena arena = line_of(3u);
    ek_pose_graph *const graph = &slam.keyframes.graph;
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        const ek_pose by = pose_of(cases[k].x, cases[k].y, cases[k].theta);
        for (size_t at = 0; at < 3u; at++) {
            for (size_t i = 0; i < 3u; i++) {
                graph->pose[i] = ORIGIN;
            }
            solved();
            graph->moved[at] = by;
            CHECK(is_correction(graph) == (cases[k].corrects && at < 2u));
        }
    }
    graph->pose[1].theta = -EK_PI; /* half a turn is half a turn, from either side */
    solved();
    graph->moved[1].theta = EK_R((double)EK_PI - 0.5 * turn);
    CHECK(!is_correction(graph));
    free(arena.memory);
}

/* Poses up to 250 km from the start are used; of others the newest loop is withdrawn, and nothing moves. */
static void poses_out_of_the_world_cost_the_newest_loop(void)
{
    const ek_pose beyond[] = {pose_of(2.5e5, -2.5e5, 0.0), pose_of(-2.51e5, 0.0, 0.0), pose_of(0.0, 2.51e5, 0.0),
                              pose_of((double)NAN, 0.0, 0.0), pose_of(0.0, 0.0, (double)INFINITY)};
    for (size_t k = 0; k < 5u; k++) {
        ek_arena arena = line_of(3u);
        ek_pose_graph *const graph = &slam.keyframes.graph;
        close_loop(1u, 0.0);
        close_loop(2u, 0.0);
        solved();
        graph->moved[2] = beyond[k];
        graph->loop[0].weight = EK_R(0.1);
        slam.odom_from_keyframe[2] = pose_of(2.0, 7.0, 0.0);
        slam.corrected = 0;
        CHECK(is_usable(graph) == (k == 0u));
        commit(&slam, &work);
        CHECK(graph->loop_count == (k ? 1u : 2u) && slam.record[0].accepted && slam.record[1].withdrawn == (k > 0u));
        CHECK_NEAR(graph->loop[0].weight, 1.0, 0.0);
        CHECK_NEAR(graph->pose[2].x, k ? 2.0 : 2.5e5, TOLERANCE);
        CHECK_NEAR(slam.next_odom_from_start.y, k ? 7.0 : 2.5e5 + 7.0, 0.1);
        CHECK(slam.task == EK_TASK_REDRAW && !slam.corrected); /* the last keyframe alone */
        free(arena.memory);
    }
    ek_arena arena = line_of(3u);
    solved();
    slam.keyframes.graph.moved[1].y = EK_R(0.5);
    slam.keyframes.apart[0] = EK_R(77.0);
    commit(&slam, &work);
    CHECK(slam.corrected);
    CHECK_NEAR(slam.keyframes.graph.pose[1].y, 0.5, 0.0);
    CHECK_NEAR(slam.keyframes.apart[0], 2.0, 1e-6); /* measured again */
    slam.keyframes.graph.solver.nodes = 2u;
    const uint64_t before = work.done;
    commit(&slam, &work);
    CHECK(work.done - before == 3u * 3u + 6u + 4u); /* the third pose is newer, and moves as the second; two steps twice */
    free(arena.memory);
}

/* What follows a run of the solver, by the largest chi-square that it leaves. */
static void runs_follow_each_other(void)
{
    ek_arena arena = line_of(4u);
    ek_pose_graph *const graph = &slam.keyframes.graph;
    close_loop(3u, 3.36); /* 11.29, below the limit of 11.345 */
    ek_slam_solve(&slam);
    CHECK(slam.task == EK_TASK_SOLVE && graph->solver.settings.max_iterations == 10);
    CHECK_NEAR(graph->solver.settings.phi, 10.0, 0.0);
    CHECK_NEAR(graph->solver.settings.tolerance, 1e-6, 1e-12);
    ek_slam_next_run(&slam, &work);
    CHECK(slam.task == EK_TASK_REDRAW && graph->loop_count == 1u);

    graph->loop_count = 0u;
    close_loop(3u, 3.37); /* 11.36 */
    close_loop(2u, 1.0);
    ek_slam_solve(&slam);
    graph->loop[0].weight = EK_R(0.25);
    ek_slam_next_run(&slam, &work);
    CHECK(slam.task == EK_TASK_DOUBT && graph->solver.settings.max_iterations == 50 && graph->loop_count == 2u);
    CHECK_NEAR(graph->loop[0].weight, 1.0, 0.0);
    CHECK_NEAR(graph->solver.settings.phi, 0.0, 0.0);

    ek_slam_next_run(&slam, &work);
    CHECK(slam.task == EK_TASK_ROUND && slam.rounds == 1 && graph->solver.settings.max_iterations == 3);
    const double mu = 11.345 / (2.0 * 3.37 * 3.37 - 11.345);
    CHECK_NEAR(slam.mu, mu, 1e-4);
    CHECK_NEAR(graph->loop[0].weight, sqrt(11.345 * mu * (mu + 1.0)) / 3.37 - mu, 1e-3);
    CHECK(slam.undecided);

    ek_slam_next_run(&slam, &work);
    CHECK(slam.task == EK_TASK_ROUND && slam.rounds == 2);
    CHECK_NEAR(slam.mu, 1.4 * mu, 1e-3);

    static const struct {
        double mu;
        int32_t undecided, rounds, more;
    } cases[] = {{1e4, 1, 59, 1}, {1.001e4, 1, 59, 0}, {1.0, 0, 59, 0}, {1.0, 1, 60, 0}, {0.001, 1, 2, 1}};
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        slam.task = EK_TASK_ROUND;
        slam.mu = EK_R(cases[k].mu);
        slam.undecided = cases[k].undecided;
        slam.rounds = cases[k].rounds;
        ek_slam_next_run(&slam, &work);
        CHECK(slam.task == (cases[k].more ? EK_TASK_ROUND : EK_TASK_SETTLE));
        CHECK(slam.rounds == cases[k].rounds + cases[k].more);
        if (!cases[k].more) {
            CHECK_NEAR(graph->loop[0].weight, 0.0, 0.0); /* beyond the limit */
            CHECK_NEAR(graph->loop[1].weight, 1.0, 0.0);
            CHECK(graph->solver.settings.max_iterations == 50);
        }
    }
    slam.task = EK_TASK_SETTLE;
    graph->loop[0].weight = EK_R(0.0);
    graph->loop[1].weight = EK_R(1.0);
    ek_slam_next_run(&slam, &work);
    CHECK(slam.task == EK_TASK_REDRAW && graph->loop_count == 1u && graph->loop[0].second == 2u);

    graph->loop_count = 0u; /* nothing left that could be doubted: the largest mu */
    close_loop(1u, 0.0);
    solved();
    slam.task = EK_TASK_DOUBT;
    ek_slam_next_run(&slam, &work);
    CHECK(slam.mu > EK_R(1e12));
    free(arena.memory);
}

int main(void)
{
    weights_follow_chi_square_and_mu();
    loops_up_to_half_a_weight_are_withdrawn();
    small_moves_are_no_corrections();
    poses_out_of_the_world_cost_the_newest_loop();
    runs_follow_each_other();
    return verdict();
}

/* The solver of slam.h: optimise the graph, withdraw loops that contradict the others, and take the solution over. */
#include "slam_parts.h"

#define PHI EK_R(10.0)
#define LIMIT EK_R(11.345)           /* 99 % quantile of chi-square with three degrees of freedom */
#define GNC_STEP EK_R(1.4)
#define GNC_ROUNDS 60
#define GNC_LARGEST EK_R(1e4)
#define KEPT EK_R(0.5)
#define CORRECTED EK_R(0.01)         /* m, and 0.5 deg: smaller changes do not count as corrections */
#define CORRECTED_THETA (EK_R(0.5) * EK_PI / EK_R(180.0))

static const ek_solver_settings QUICK = {10, EK_R(1e-6), PHI}, PLAIN = {50, EK_R(1e-9), EK_R(0.0)};
static const ek_solver_settings ROUND = {3, EK_R(1e-9), EK_R(0.0)};

void ek_slam_solve(ek_slam *slam)
{
    ek_pose_graph_begin(&slam->keyframes.graph, &QUICK, 1);
    slam->task = EK_TASK_SOLVE;
}

ek_pose ek_slam_odom_from_start(const ek_slam *slam)
{
    const size_t last = slam->keyframes.count - 1u;
    return ek_se2_compose(slam->odom_from_keyframe[last], ek_se2_inverse(slam->keyframes.graph.pose[last]));
}

static ek_real largest_chi(const ek_pose_graph *graph)
{
    ek_real largest = EK_R(0.0);
    for (size_t l = 0; l < graph->loop_count; l++) {
        const ek_real chi = ek_pose_graph_chi(graph->loop + l, graph->moved);
        largest = chi > largest ? chi : largest;
    }
    return largest;
}

static void set_weights(ek_pose_graph *graph, ek_real weight)
{
    for (size_t l = 0; l < graph->loop_count; l++) {
        graph->loop[l].weight = weight;
    }
}

/* Weights of truncated least squares; 1 if one is neither 0 nor 1. */
static int truncate_weights(ek_pose_graph *graph, ek_real mu)
{
    int undecided = 0;
    for (size_t l = 0; l < graph->loop_count; l++) {
        const ek_real chi = ek_pose_graph_chi(graph->loop + l, graph->moved);
        const ek_real low = mu / (mu + EK_R(1.0)) * LIMIT, high = (mu + EK_R(1.0)) / mu * LIMIT;
        const ek_real least = chi > EK_R(1e-30) ? chi : EK_R(1e-30);
        ek_real weight = EK_SQRT(LIMIT * mu * (mu + EK_R(1.0)) / least) - mu;
        weight = weight < EK_R(0.0) ? EK_R(0.0) : weight < EK_R(1.0) ? weight : EK_R(1.0);
        weight = chi <= low ? EK_R(1.0) : chi >= high ? EK_R(0.0) : weight;
        graph->loop[l].weight = weight;
        undecided |= weight > EK_R(0.0) && weight < EK_R(1.0); /* small weights are not yet decided */
    }
    return undecided;
}

/* Remove the loops without weight from the graph. */
static void withdraw(ek_slam *slam)
{
    ek_pose_graph *const graph = &slam->keyframes.graph;
    size_t kept = 0u;
    for (size_t l = 0; l < graph->loop_count; l++) {
        ek_loop_record *const now = slam->record + slam->record_of_loop[l];
        if (graph->loop[l].weight > KEPT) {
            slam->record_of_loop[kept] = slam->record_of_loop[l];
            graph->loop[kept++] = graph->loop[l];
        } else {
            now->accepted = 0;
            now->withdrawn = 1;
        }
    }
    graph->loop_count = kept;
}

/* 1 if the solver moved an earlier keyframe against the first one. */
static int is_correction(const ek_pose_graph *graph)
{
    for (size_t k = 0; k + 1u < graph->solver.nodes; k++) {
        const ek_real x = graph->moved[k].x - graph->pose[k].x, y = graph->moved[k].y - graph->pose[k].y;
        const ek_real turn = EK_FABS(ek_se2_wrap(graph->moved[k].theta - graph->pose[k].theta));
        if (x * x + y * y > CORRECTED * CORRECTED || turn > CORRECTED_THETA) {
            return 1;
        }
    }
    return 0;
}

static int is_usable(const ek_pose_graph *graph)
{
    for (size_t k = 0; k < graph->solver.nodes; k++) {
        const ek_pose pose = graph->moved[k];
        if (!ek_se2_is_finite(pose) || EK_FABS(pose.x) > EK_R(0.25) * EK_MAX_COORDINATE ||
            EK_FABS(pose.y) > EK_R(0.25) * EK_MAX_COORDINATE) {
            return 0;
        }
    }
    return 1;
}

/* Take the solution over; a solution that is none takes the newest loop away. */
static void commit(ek_slam *slam, ek_work *work)
{
    ek_pose_graph *const graph = &slam->keyframes.graph;
    if (is_usable(graph)) {
        slam->corrected |= is_correction(graph);
        ek_pose_graph_commit(graph);
    } else {
        set_weights(graph, EK_R(1.0));
        graph->loop[graph->loop_count - 1u].weight = EK_R(0.0);
        withdraw(slam);
    }
    set_weights(graph, EK_R(1.0));
    ek_work_spend(work, 3u * (uint64_t)graph->count + EK_MOVE_WORK * (uint64_t)(graph->count - graph->solver.nodes));
    ek_keyframes_measure(&slam->keyframes, work);
    slam->next_odom_from_start = ek_slam_odom_from_start(slam);
    ek_slam_redraw(slam);
}

void ek_slam_next_run(ek_slam *slam, ek_work *work)
{
    ek_pose_graph *const graph = &slam->keyframes.graph;
    if (slam->task == EK_TASK_SOLVE) {
        if (largest_chi(graph) <= LIMIT) {
            commit(slam, work);
            return;
        }
        set_weights(graph, EK_R(1.0));
        ek_pose_graph_begin(graph, &PLAIN, 1);
        slam->task = EK_TASK_DOUBT;
        return;
    }
    if (slam->task == EK_TASK_SETTLE) {
        withdraw(slam);
        commit(slam, work);
        return;
    }
    int more = slam->task == EK_TASK_DOUBT;
    if (more) {
        const ek_real over = EK_R(2.0) * largest_chi(graph) - LIMIT;
        slam->mu = LIMIT / (over > EK_R(1e-12) ? over : EK_R(1e-12));
        slam->rounds = 0;
        slam->task = EK_TASK_ROUND;
    } else {
        more = slam->mu <= GNC_LARGEST && slam->undecided && slam->rounds < GNC_ROUNDS;
        slam->mu *= GNC_STEP;
    }
    if (more) {
        slam->undecided = truncate_weights(graph, slam->mu); /* 1: undecided, another round may be needed */
        slam->rounds++;
        ek_pose_graph_begin(graph, &ROUND, 0);
        return;
    }
    for (size_t l = 0; l < graph->loop_count; l++) {
        graph->loop[l].weight = ek_pose_graph_chi(graph->loop + l, graph->moved) <= LIMIT ? EK_R(1.0) : EK_R(0.0);
    }
    ek_pose_graph_begin(graph, &PLAIN, 0);
    slam->task = EK_TASK_SETTLE;
}

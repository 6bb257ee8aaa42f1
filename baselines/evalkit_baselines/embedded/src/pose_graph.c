#include "graph_parts.h"

#include <string.h>

#define MAX_POSES ((size_t)1 << 20)
#define MAX_LOOPS ((size_t)1024)
#define MIN_WEIGHT EK_R(1e-12) /* loops below it do not take part */

ek_status ek_pose_graph_init(ek_pose_graph *graph, ek_arena *arena, size_t poses, size_t loops)
{
    if (!graph || !arena) {
        return EK_NULL_POINTER;
    }
    if (poses == 0u || poses > MAX_POSES || loops == 0u || loops > MAX_LOOPS) {
        return EK_OUT_OF_RANGE;
    }
    memset(graph, 0, sizeof *graph);
    graph->capacity = poses;
    graph->loop_capacity = loops;
    graph->pose = (ek_pose *)ek_arena_alloc(arena, poses, sizeof(ek_pose));
    graph->step = (ek_step *)ek_arena_alloc(arena, poses, sizeof(ek_step));
    graph->loop = (ek_loop_edge *)ek_arena_alloc(arena, loops, sizeof(ek_loop_edge));
    graph->moved = (ek_pose *)ek_arena_alloc(arena, poses, sizeof(ek_pose));
    graph->covariance = (ek_sym3 *)ek_arena_alloc(arena, poses, sizeof(ek_sym3));
    graph->offset = (ek_real *)ek_arena_alloc(arena, 3u * poses, sizeof(ek_real));
    graph->chi = (ek_real *)ek_arena_alloc(arena, loops, sizeof(ek_real));
    graph->used = (uint32_t *)ek_arena_alloc(arena, loops, sizeof(uint32_t));
    graph->matrix = (ek_real *)ek_arena_alloc(arena, 9u * ek_graph_triangle(loops + 1u), sizeof(ek_real));
    graph->right = (ek_real *)ek_arena_alloc(arena, 3u * (loops + 1u), sizeof(ek_real));
    return EK_OK;
}

void ek_pose_graph_reset(ek_pose_graph *graph)
{
    graph->count = graph->loop_count = 0u;
    graph->solver.phase = EK_SOLVER_IDLE;
}

static ek_status check_edge(ek_pose motion, const ek_sym3 *information)
{
    ek_sym3 inverse;
    const ek_real sum = information->xx + information->yy + information->tt;
    if (!ek_se2_is_finite(motion) || !isfinite(sum + information->xy + information->xt + information->yt)) {
        return EK_NOT_FINITE;
    }
    const int near = EK_FABS(motion.x) <= EK_MAX_COORDINATE && EK_FABS(motion.y) <= EK_MAX_COORDINATE;
    return near && ek_sym3_inverse(information, &inverse) ? EK_OK : EK_OUT_OF_RANGE;
}

ek_status ek_pose_graph_add(ek_pose_graph *graph, ek_pose last_from_pose, const ek_sym3 *information)
{
    const ek_pose identity = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    if (!graph || !information) {
        return EK_NULL_POINTER;
    }
    if (graph->count == graph->capacity) {
        return EK_TOO_MANY_POINTS;
    }
    const size_t row = graph->count;
    if (row > 0u) {
        const ek_status status = check_edge(last_from_pose, information);
        if (status != EK_OK) {
            return status;
        }
    }
    graph->pose[row] = row ? ek_se2_compose(graph->pose[row - 1u], last_from_pose) : identity;
    graph->step[row].last_from_pose = row ? last_from_pose : identity;
    graph->step[row].information = *information;
    graph->count++;
    return EK_OK;
}

ek_status ek_pose_graph_close(ek_pose_graph *graph, const ek_loop_edge *loop)
{
    if (!graph || !loop) {
        return EK_NULL_POINTER;
    }
    if (graph->loop_count == graph->loop_capacity) {
        return EK_TOO_MANY_POINTS;
    }
    if (loop->first >= loop->second || loop->second >= graph->count) {
        return EK_OUT_OF_RANGE;
    }
    const ek_status status = check_edge(loop->first_from_second, &loop->information);
    if (status == EK_OK) {
        graph->loop[graph->loop_count] = *loop;
        graph->loop[graph->loop_count++].weight = EK_R(1.0);
    }
    return status;
}

static void restart_iteration(ek_solver *solver)
{
    solver->phase = EK_SOLVER_CHAIN;
    solver->node = solver->row = solver->column = 0u;
}

ek_status ek_pose_graph_begin(ek_pose_graph *graph, const ek_solver_settings *settings, int restart)
{
    if (!graph || !settings) {
        return EK_NULL_POINTER;
    }
    if (settings->max_iterations < 1 || !isfinite(settings->tolerance) || settings->tolerance < EK_R(0.0) ||
        !isfinite(settings->phi) || settings->phi < EK_R(0.0) || graph->count == 0u) {
        return EK_OUT_OF_RANGE;
    }
    ek_solver *const solver = &graph->solver;
    const size_t nodes = restart ? graph->count : solver->nodes;
    if (restart) {
        EK_COUNT(EK_CELLS, nodes * sizeof *graph->moved / sizeof(uint32_t));
        memcpy(graph->moved, graph->pose, nodes * sizeof *graph->moved);
    }
    memset(solver, 0, sizeof *solver);
    solver->settings = *settings;
    solver->nodes = nodes;
    solver->before = (ek_real)INFINITY;
    solver->origin = graph->moved[nodes / 2u];
    restart_iteration(solver);
    return EK_OK;
}

ek_status ek_pose_graph_predict(ek_pose_graph *graph, uint32_t first, uint32_t second)
{
    const ek_solver_settings once = {1, EK_R(0.0), EK_R(0.0)};
    if (!graph) {
        return EK_NULL_POINTER;
    }
    if (first >= second || second >= graph->count) {
        return EK_OUT_OF_RANGE;
    }
    const ek_status status = ek_pose_graph_begin(graph, &once, 1);
    graph->solver.predict = 1;
    graph->solver.predict_first = first;
    graph->solver.predict_second = second;
    return status;
}

ek_real ek_pose_graph_chi(const ek_loop_edge *loop, const ek_pose *pose)
{
    const ek_pose gap = ek_se2_between(loop->first_from_second, ek_se2_between(pose[loop->first], pose[loop->second]));
    const ek_real residual[3] = {gap.x, gap.y, gap.theta};
    return ek_sym3_quadratic(&loop->information, residual);
}

/* Sum up covariances and residuals of the steps along the chain. */
static void sum_chain(ek_pose_graph *graph, ek_work *work)
{
    static const ek_sym3 none = {EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    ek_solver *const solver = &graph->solver;
    if (solver->node == 0u) {
        graph->covariance[0] = none;
        memset(graph->offset, 0, 3u * sizeof *graph->offset);
        solver->chi_square = EK_R(0.0);
        solver->node = 1u;
    }
    for (; solver->node < solver->nodes && work->left > 0; solver->node++) {
        const size_t k = solver->node;
        const ek_step *const step = graph->step + k;
        ek_real residual[3], inverse[9], twist[3];
        ek_sym3 covariance = none;
        ek_graph_linearise(graph->moved[k - 1u], graph->moved[k], step->last_from_pose, solver->origin, residual, inverse);
        ek_graph_multiply(inverse, residual, twist);
        ek_sym3_inverse(&step->information, &covariance);
        covariance = ek_sym3_congruence(inverse, &covariance);
        graph->covariance[k] = ek_sym3_sum(graph->covariance + k - 1u, &covariance, EK_R(1.0));
        for (size_t i = 0; i < 3u; i++) {
            graph->offset[3u * k + i] = graph->offset[3u * (k - 1u) + i] + twist[i];
        }
        solver->chi_square += ek_sym3_quadratic(&step->information, residual);
        ek_work_spend(work, EK_NODE_WORK);
    }
    if (solver->node >= solver->nodes) {
        solver->phase = EK_SOLVER_LOOPS;
    }
}

/* Weights and residuals of the loops, then the stop rule. At most EK_NODE_WORK operations a loop, in one part. */
static void weigh_loops(ek_pose_graph *graph, ek_work *work)
{
    ek_solver *const solver = &graph->solver;
    const ek_real phi = solver->settings.phi;
    solver->active = 0u;
    for (size_t l = 0; l < graph->loop_count; l++) {
        ek_loop_edge *const loop = graph->loop + l;
        graph->chi[l] = ek_pose_graph_chi(loop, graph->moved);
        if (phi > EK_R(0.0)) {
            const ek_real share = EK_R(2.0) * phi / (phi + graph->chi[l]);
            loop->weight = share < EK_R(1.0) ? share * share : EK_R(1.0);
        }
        solver->chi_square += loop->weight * graph->chi[l];
        if (solver->predict || loop->weight > MIN_WEIGHT) {
            graph->used[solver->active++] = (uint32_t)l;
        }
    }
    ek_work_spend(work, EK_NODE_WORK * (uint64_t)graph->loop_count + 1u);
    const ek_real change = EK_FABS(solver->before - solver->chi_square);
    const ek_real scale = solver->chi_square > EK_R(1e-12) ? solver->chi_square : EK_R(1e-12);
    solver->converged = !solver->predict && change <= solver->settings.tolerance * scale;
    solver->before = solver->chi_square;
    solver->row = solver->column = 0u;
    solver->phase = solver->converged || (!solver->predict && solver->iterations == solver->settings.max_iterations)
                        ? EK_SOLVER_IDLE
                        : EK_SOLVER_MATRIX;
}

/* Move the poses by the step: each step changes by its covariance times the forces of the loops across it. */
static void move_poses(ek_pose_graph *graph, ek_work *work)
{
    ek_solver *const solver = &graph->solver;
    for (; solver->node < solver->nodes && work->left > 0; solver->node++) {
        const size_t k = solver->node;
        const ek_step *const step = graph->step + k;
        ek_pose *const pose = graph->moved + k;
        ek_real residual[3], inverse[9], twist[3];
        ek_sym3 q = {EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(0.0)};
        ek_graph_linearise(solver->last, *pose, step->last_from_pose, solver->origin, residual, inverse);
        solver->last = *pose;
        ek_graph_multiply(inverse, residual, twist);
        ek_sym3_inverse(&step->information, &q);
        q = ek_sym3_congruence(inverse, &q);
        const ek_real *const pull = solver->pull;
        solver->twist[0] -= q.xx * pull[0] + q.xy * pull[1] + q.xt * pull[2] + twist[0];
        solver->twist[1] -= q.xy * pull[0] + q.yy * pull[1] + q.yt * pull[2] + twist[1];
        solver->twist[2] -= q.xt * pull[0] + q.yt * pull[1] + q.tt * pull[2] + twist[2];
        const ek_real x = pose->x - solver->origin.x, y = pose->y - solver->origin.y;
        pose->x += solver->twist[0] - solver->twist[2] * y;
        pose->y += solver->twist[1] + solver->twist[2] * x;
        pose->theta = ek_se2_wrap(pose->theta + solver->twist[2]);
        for (size_t i = 0; i < 3u; i++) {
            solver->pull[i] += graph->offset[3u * k + i];
        }
        ek_work_spend(work, EK_NODE_WORK);
    }
    if (solver->node >= solver->nodes) {
        solver->iterations++;
        restart_iteration(solver);
    }
}

int ek_pose_graph_work(ek_pose_graph *graph, ek_work *work)
{
    static void (*const phases[])(ek_pose_graph *, ek_work *) = {
        NULL, sum_chain, weigh_loops, ek_graph_factor, ek_graph_substitute_back, move_poses};
    while (graph->solver.phase != EK_SOLVER_IDLE && work->left > 0) {
        phases[graph->solver.phase](graph, work);
    }
    return graph->solver.phase == EK_SOLVER_IDLE;
}

void ek_pose_graph_commit(ek_pose_graph *graph)
{
    const size_t nodes = graph->solver.nodes;
    if (nodes == 0u) {
        return;
    }
    const ek_pose before = graph->pose[nodes - 1u], after = graph->moved[nodes - 1u];
    for (size_t k = nodes; k < graph->count; k++) {
        graph->pose[k] = ek_se2_compose(after, ek_se2_between(before, graph->pose[k]));
    }
    memcpy(graph->pose, graph->moved, nodes * sizeof *graph->pose);
}

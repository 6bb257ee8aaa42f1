/* The linear system of pose_graph.h: residuals and covariances of its rows, factorisation and substitution in slices. */
#include "graph_parts.h"

#include <string.h>

#define BLOCK_WORK 3u /* operations for a product of two blocks */

static ek_real *block(const ek_pose_graph *graph, size_t row, size_t column)
{
    return graph->matrix + 9u * (ek_graph_triangle(row) + column);
}

void ek_graph_linearise(ek_pose first, ek_pose second, ek_pose measured, ek_pose origin, ek_real residual[3],
                      ek_real inverse[9])
{
    const ek_pose gap = ek_se2_between(measured, ek_se2_between(first, second));
    const ek_real turned = first.theta + measured.theta, c = EK_COS(turned), s = EK_SIN(turned);
    residual[0] = gap.x;
    residual[1] = gap.y;
    residual[2] = gap.theta;
    inverse[0] = inverse[4] = c;
    inverse[1] = -s;
    inverse[3] = s;
    inverse[2] = second.y - origin.y;
    inverse[5] = origin.x - second.x;
    inverse[6] = inverse[7] = EK_R(0.0);
    inverse[8] = EK_R(1.0);
}

void ek_graph_multiply(const ek_real matrix[9], const ek_real v[3], ek_real product[3])
{
    for (size_t i = 0; i < 3u; i++) {
        product[i] = matrix[3u * i] * v[0] + matrix[3u * i + 1u] * v[1] + matrix[3u * i + 2u] * v[2];
    }
}

/* Ends of the row of the matrix: a loop, or the predicted edge behind the last one. */
static void ends_of(const ek_pose_graph *graph, size_t row, uint32_t *first, uint32_t *second)
{
    const int beyond = row == graph->solver.active;
    const ek_loop_edge *const loop = beyond ? NULL : graph->loop + graph->used[row];
    *first = loop ? loop->first : graph->solver.predict_first;
    *second = loop ? loop->second : graph->solver.predict_second;
}

/* Covariance of the steps that two edges share, and on the diagonal that of the loop itself. */
static ek_sym3 shared_covariance(const ek_pose_graph *graph, size_t row, size_t column)
{
    ek_sym3 shared = {EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    uint32_t a, b, c, d;
    ends_of(graph, row, &a, &b);
    ends_of(graph, column, &c, &d);
    const uint32_t from = a > c ? a : c, to = b < d ? b : d;
    if (from < to) {
        shared = ek_sym3_sum(graph->covariance + to, graph->covariance + from, EK_R(-1.0));
    }
    if (row == column && row < graph->solver.active) {
        const ek_loop_edge *const loop = graph->loop + graph->used[row];
        ek_real residual[3], inverse[9];
        ek_sym3 own;
        ek_graph_linearise(graph->moved[a], graph->moved[b], loop->first_from_second, graph->solver.origin, residual, inverse);
        ek_sym3_inverse(&loop->information, &own);
        own = ek_sym3_congruence(inverse, &own);
        const ek_real weight = graph->solver.predict ? EK_R(1.0) : loop->weight;
        shared = ek_sym3_sum(&shared, &own, EK_R(1.0) / weight);
    }
    return shared;
}

/* into -= a b^T for blocks of 3 x 3. */
static void subtract_product(ek_real *EK_RESTRICT into, const ek_real *EK_RESTRICT a, const ek_real *EK_RESTRICT b)
{
    for (size_t i = 0; i < 3u; i++) {
        for (size_t j = 0; j < 3u; j++) {
            into[3u * i + j] -= a[3u * i] * b[3u * j] + a[3u * i + 1u] * b[3u * j + 1u] + a[3u * i + 2u] * b[3u * j + 2u];
        }
    }
}

/* x with L x = v for a lower triangular block. */
static void solve_lower(const ek_real lower[9], ek_real v[3])
{
    v[0] = v[0] / lower[0];
    v[1] = (v[1] - lower[3] * v[0]) / lower[4];
    v[2] = (v[2] - lower[6] * v[0] - lower[7] * v[1]) / lower[8];
}

/* x with L^T x = v. */
static void solve_upper(const ek_real lower[9], ek_real v[3])
{
    v[2] = v[2] / lower[8];
    v[1] = (v[1] - lower[7] * v[2]) / lower[4];
    v[0] = (v[0] - lower[3] * v[1] - lower[6] * v[2]) / lower[0];
}

/* The right-hand side of a row: its residual as a twist without that of its steps, after forward substitution. */
static void substitute_forward(ek_pose_graph *graph, size_t row)
{
    const ek_loop_edge *const loop = graph->loop + graph->used[row];
    ek_real residual[3], inverse[9], *const right = graph->right + 3u * row;
    ek_graph_linearise(graph->moved[loop->first], graph->moved[loop->second], loop->first_from_second, graph->solver.origin,
              residual, inverse);
    ek_graph_multiply(inverse, residual, right);
    for (size_t i = 0; i < 3u; i++) {
        right[i] -= graph->offset[3u * loop->second + i] - graph->offset[3u * loop->first + i];
    }
    for (size_t m = 0; m < row; m++) {
        const ek_real *const left = block(graph, row, m), *const known = graph->right + 3u * m;
        for (size_t i = 0; i < 3u; i++) {
            right[i] -= left[3u * i] * known[0] + left[3u * i + 1u] * known[1] + left[3u * i + 2u] * known[2];
        }
    }
    solve_lower(block(graph, row, row), right);
}

/* One block of the factor of the matrix; 0 if the matrix is not positive definite. */
static int factor_block(ek_pose_graph *graph, size_t row, size_t column)
{
    const ek_sym3 sum = shared_covariance(graph, row, column);
    ek_real *const now = block(graph, row, column);
    const ek_real full[9] = {sum.xx, sum.xy, sum.xt, sum.xy, sum.yy, sum.yt, sum.xt, sum.yt, sum.tt};
    memcpy(now, full, sizeof full);
    const ek_real *const left = block(graph, row, 0u), *const above = block(graph, column, 0u);
    for (size_t m = 0; m < column; m++) {
        subtract_product(now, left + 9u * m, above + 9u * m);
    }
    if (column < row) {
        for (size_t i = 0; i < 9u; i += 3u) {
            solve_lower(block(graph, column, column), now + i);
        }
        return 1;
    }
    const ek_sym3 rest = {now[0], now[3], now[6], now[4], now[7], now[8]};
    if (row == graph->solver.active) {
        graph->solver.predicted = rest;
        return 1;
    }
    return ek_sym3_factor(&rest, now);
}

/* The covariance in the frame of the second pose. */
static void finish_prediction(ek_pose_graph *graph)
{
    ek_solver *const solver = &graph->solver;
    const ek_pose second = graph->moved[solver->predict_second];
    const ek_real c = EK_COS(second.theta), s = EK_SIN(second.theta);
    const ek_real x = second.x - solver->origin.x, y = second.y - solver->origin.y;
    const ek_real turn[9] = {c, s, s * x - c * y, -s, c, s * y + c * x, EK_R(0.0), EK_R(0.0), EK_R(1.0)};
    solver->predicted = ek_sym3_congruence(turn, &solver->predicted);
    solver->phase = EK_SOLVER_IDLE;
}

void ek_graph_factor(ek_pose_graph *graph, ek_work *work)
{
    ek_solver *const solver = &graph->solver;
    const size_t rows = solver->active + (solver->predict ? 1u : 0u);
    while (solver->row < rows && work->left > 0) {
        if (!factor_block(graph, solver->row, solver->column)) {
            solver->singular = 1;
            solver->phase = EK_SOLVER_IDLE;
            return;
        }
        ek_work_spend(work, BLOCK_WORK * (uint64_t)(solver->column + 4u));
        if (++solver->column > solver->row) {
            if (!solver->predict) {
                substitute_forward(graph, solver->row);
            }
            ek_work_spend(work, solver->row + 1u);
            solver->row++;
            solver->column = 0u;
        }
    }
    if (solver->row < rows) {
        return;
    }
    if (solver->predict) {
        finish_prediction(graph);
        return;
    }
    solver->phase = EK_SOLVER_BACK;
}

void ek_graph_substitute_back(ek_pose_graph *graph, ek_work *work)
{
    ek_solver *const solver = &graph->solver;
    for (; solver->row > 0u && work->left > 0; solver->row--) {
        const size_t row = solver->row - 1u;
        ek_real *const right = graph->right + 3u * row;
        solve_upper(block(graph, row, row), right);
        for (size_t m = 0; m < row; m++) {
            const ek_real *const left = block(graph, row, m);
            ek_real *const other = graph->right + 3u * m;
            for (size_t i = 0; i < 3u; i++) {
                other[i] -= left[i] * right[0] + left[3u + i] * right[1] + left[6u + i] * right[2];
            }
        }
        ek_work_spend(work, row + 1u);
    }
    if (solver->row > 0u) {
        return;
    }
    memset(graph->offset, 0, 3u * solver->nodes * sizeof *graph->offset);
    for (size_t l = 0; l < solver->active; l++) {
        const ek_loop_edge *const loop = graph->loop + graph->used[l];
        for (size_t i = 0; i < 3u; i++) {
            graph->offset[3u * loop->first + i] += graph->right[3u * l + i];
            graph->offset[3u * loop->second + i] -= graph->right[3u * l + i];
        }
    }
    ek_work_spend(work, solver->nodes + solver->active);
    memset(solver->twist, 0, sizeof solver->twist);
    memcpy(solver->pull, graph->offset, sizeof solver->pull);
    solver->last = graph->moved[0];
    solver->node = 1u;
    solver->phase = EK_SOLVER_MOVE;
}


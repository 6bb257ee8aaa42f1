// The pose graph of the core: one optimisation.
#pragma once

#include "ek/pose_graph.h"
#include "memory.hpp"

namespace EK_NAME(binding) {

using Rows = nb::ndarray<const ek_real, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Ends = nb::ndarray<const uint32_t, nb::shape<-1, 2>, nb::c_contig, nb::device::cpu>;

// Poses, chi-square, iterations, converged, and the weights of the loops.
using Optimised = std::tuple<nb::object, double, int32_t, bool, nb::object>;

inline ek_pose pose_in(const Rows &rows, std::size_t row)
{
    return {rows(row, 0), rows(row, 1), rows(row, 2)};
}

inline ek_sym3 information_in(const Rows &rows, std::size_t row)
{
    return {rows(row, 0), rows(row, 1), rows(row, 2), rows(row, 3), rows(row, 4), rows(row, 5)};
}

// Poses (N, 3); steps (N - 1, 3) with information (N - 1, 6); loops between ends (L, 2), motions (L, 3) with information
// (L, 6). `slice`: operations of one slice.
inline Optimised optimise_graph(const Rows &poses, const Rows &steps, const Rows &step_information, const Ends &ends,
                                const Rows &motions, const Rows &information, int64_t max_iterations, double tolerance,
                                double phi, int64_t slice)
{
    const std::size_t nodes = poses.shape(0), loops = ends.shape(0);
    if (poses.shape(1) != 3 || steps.shape(1) != 3 || motions.shape(1) != 3 || step_information.shape(1) != 6 ||
        information.shape(1) != 6 || nodes == 0 || steps.shape(0) != nodes - 1 ||
        step_information.shape(0) != nodes - 1 || motions.shape(0) != loops || information.shape(0) != loops) {
        throw std::invalid_argument("graph: the shapes of its arrays do not match");
    }
    ek_pose_graph graph = {};
    const Memory memory("graph", [&](ek_arena *arena) {
        return ek_pose_graph_init(&graph, arena, nodes, std::max<std::size_t>(loops, 1));
    });
    const ek_sym3 none = {1, 0, 0, 1, 0, 1};
    for (std::size_t row = 0; row < nodes; row++) {
        const ek_sym3 known = row ? information_in(step_information, row - 1) : none;
        require(ek_pose_graph_add(&graph, row ? pose_in(steps, row - 1) : ek_pose{}, &known), "steps");
        graph.pose[row] = pose_in(poses, row);
        require(ek_se2_is_finite(graph.pose[row]) ? EK_OK : EK_NOT_FINITE, "poses");
    }
    for (std::size_t row = 0; row < loops; row++) {
        const ek_loop_edge loop = {ends(row, 0), ends(row, 1), pose_in(motions, row), information_in(information, row),
                                   1};
        require(ek_pose_graph_close(&graph, &loop), "loops");
    }
    const ek_solver_settings settings = {whole(max_iterations), ek_real(tolerance), ek_real(phi)};
    require(ek_pose_graph_begin(&graph, &settings, 1), "settings");
    {
        const nb::gil_scoped_release others_may_run;
        for (int done = 0; !done;) {
            ek_work work = ek_work_make(std::max<int64_t>(slice, 1));
            done = ek_pose_graph_work(&graph, &work);
        }
    }
    ek_pose_graph_commit(&graph);
    std::vector<ek_real> moved, weights;
    for (std::size_t row = 0; row < nodes; row++) {
        moved.insert(moved.end(), {graph.pose[row].x, graph.pose[row].y, graph.pose[row].theta});
    }
    for (std::size_t row = 0; row < loops; row++) {
        weights.push_back(graph.loop[row].weight);
    }
    return {array_of(std::move(moved), {nodes, 3}), double(graph.solver.chi_square), graph.solver.iterations,
            graph.solver.converged != 0, array_of(std::move(weights), {loops, 1})};
}

} // namespace EK_NAME(binding)

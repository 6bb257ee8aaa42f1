// Python bindings of the embedded core, compiled once per precision. Arrays are passed without copies; the GIL is
// released during calls. The meaning of each function is in the core's headers and in _core64.pyi.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include "defaults.hpp"
#include "graph.hpp"
#include "grid.hpp"
#include "pipeline.hpp"
#include "slam.hpp"

NB_MODULE(CORE, module)
{
    using namespace EK_NAME(binding);
    using namespace nanobind::literals;
    module.attr("REAL") = sizeof(ek_real) == 8 ? "float64" : "float32";
    module.def("defaults", &defaults);

    nb::class_<Index>(module, "Index")
        .def(nb::init<const Points &, int64_t, int64_t, const std::optional<Counts> &,
                      const std::optional<Points> &, bool>(), "points"_a.noconvert(),
             "neighbours"_a = 0, nb::kw_only(), "table"_a = 0, "support"_a.noconvert() = nb::none(),
             "seen_from"_a.noconvert() = nb::none(), "noisy"_a = false)
        .def("__len__", [](const Index &index) { return index.index().count; });

    module.def("normals", &normals, "points"_a.noconvert(), "neighbours"_a, "radius"_a);

    nb::class_<Icp>(module, "Icp")
        .def(nb::init<double, int64_t, int64_t, bool, bool, double, int64_t, bool, double, bool>(), nb::kw_only(), "epsilon"_a,
             "max_iterations"_a, "error"_a, "error_before"_a, "one_to_one"_a, "max_correspondence"_a, "min_pairs"_a,
             "lines"_a = false, "cauchy"_a = 0.0, "share_noise"_a = false)
        .def("register", &Icp::answer, "target"_a, "source"_a.noconvert(), "guess"_a, "trace"_a = false,
             nb::kw_only(), "origin"_a = nb::none());

    nb::class_<Grid>(module, "Grid")
        .def(nb::init<double, double, double, double, double, double, const Extent &, bool, double>(), nb::kw_only(),
             "resolution"_a, "l_occ"_a, "l_free"_a, "l_min"_a, "l_max"_a, "range_max"_a, "extent"_a, "polygon"_a = false,
             "widest_gap"_a = 0.0)
        .def("add", &Grid::add, "world_from_sensor"_a, "hits"_a.noconvert(), "misses"_a.noconvert())
        .def("move", &Grid::move, "extent"_a, "range_max"_a)
        .def("cells", &Grid::cells)
        .def_prop_ro("touched", &Grid::touched)
        .def_prop_ro("ignored_beams", &Grid::ignored_beams);

    module.def("optimise_graph", &optimise_graph, "poses"_a.noconvert(), "steps"_a.noconvert(),
               "step_information"_a.noconvert(), "ends"_a.noconvert(), "motions"_a.noconvert(),
               "information"_a.noconvert(), nb::kw_only(), "max_iterations"_a, "tolerance"_a, "phi"_a = 0.0,
               "slice_work"_a = INT64_MAX);

    nb::class_<Pipeline>(module, "Pipeline")
        .def(nb::init<const Icp &, bool, bool, bool, double, int64_t, double, double, int64_t, int64_t, int64_t, double,
                      double, int64_t>(),
             "icp"_a, nb::kw_only(), "scan_to_scan"_a, "scan_to_map"_a, "deskew"_a, "local_radius"_a, "keyframes"_a,
             "keyframe_distance"_a, "keyframe_angle"_a, "min_inliers"_a, "beams"_a, "neighbours"_a = 8,
             "map_voxel"_a = 0.0, "map_radius"_a = 15.0, "voxels"_a = 1)
        .def("update", &Pipeline::update, nb::kw_only(), "stamp_ns"_a, "time_increment_ns"_a, "ranges"_a.noconvert(),
             "angles"_a.noconvert(), "odom_from_base"_a.none(), "start_from_end"_a.none(), "base_from_sensor"_a,
             "range_limits"_a)
        .def_prop_ro("dropped_cells", &Pipeline::dropped);

    nb::class_<Slam>(module, "Slam")
        .def(nb::init<const Icp &, const nb::dict &, const nb::dict &>(), "icp"_a, "real"_a, "number"_a)
        .def("update", &Slam::update, nb::kw_only(), "stamp_ns"_a, "time_increment_ns"_a, "ranges"_a.noconvert(),
             "angles"_a.noconvert(), "odom_from_base"_a.none(), "start_from_end"_a.none(), "base_from_sensor"_a,
             "range_limits"_a)
        .def("correct", &Slam::correct, "keyframes"_a.noconvert(), "poses"_a.noconvert())
        .def("records", &Slam::records)
        .def_prop_ro("memory_bytes", &Slam::bytes)
        .def_prop_ro("keyframes", &Slam::keyframes)
        .def_prop_ro("dropped_cells", &Slam::dropped)
        .def_prop_ro("unrecorded", &Slam::unrecorded)
        .def_prop_ro("busy", &Slam::busy);
}

// The default parameters of the core (ek_..._default) for Python, by its names and in its units. None is set here; a test
// compares them with those of the Python parameters.
#pragma once

#include "ek/pipeline.h"
#include "memory.hpp"

namespace EK_NAME(binding) {

inline nb::dict defaults_of(const ek_icp_parameters &icp)
{
    nb::dict values;
    values["epsilon"] = double(icp.epsilon);
    values["max_iterations"] = icp.max_iterations;
    values["error"] = int(icp.error);
    values["error_before"] = icp.error_before != 0;
    values["one_to_one"] = icp.one_to_one != 0;
    values["max_correspondence_m"] = double(icp.max_correspondence);
    values["min_pairs"] = icp.min_pairs;
    values["lines"] = icp.metric == EK_METRIC_LINE;
    values["cauchy_m"] = double(icp.cauchy);
    values["share_noise"] = icp.share_noise != 0;
    return values;
}

inline nb::dict defaults_of(const ek_grid_parameters &grid)
{
    nb::dict values;
    values["resolution_m"] = double(grid.resolution);
    values["l_occ"] = double(grid.l_occ);
    values["l_free"] = double(grid.l_free);
    values["l_min"] = double(grid.l_min);
    values["l_max"] = double(grid.l_max);
    values["widest_gap_rad"] = double(grid.widest_gap);
    return values;
}

inline nb::dict defaults()
{
    const ek_pipeline_parameters pipeline = ek_pipeline_default();
    const ek_frontend_parameters &frontend = pipeline.frontend;
    nb::dict stages;
    stages["scan_to_scan"] = frontend.use_scan_to_scan != 0;
    stages["scan_to_map"] = frontend.use_scan_to_map != 0;
    stages["deskew"] = pipeline.deskew != 0;
    stages["local_radius_m"] = double(pipeline.scan.local_radius);
    stages["keyframes"] = frontend.keyframes;
    stages["keyframe_distance_m"] = double(frontend.keyframe_distance);
    stages["keyframe_angle_rad"] = double(frontend.keyframe_angle);
    stages["min_inliers"] = frontend.min_inliers;
    stages["line_neighbours"] = frontend.neighbours;
    stages["local_map_voxel_m"] = double(frontend.map_voxel);
    stages["local_map_radius_m"] = double(frontend.map_radius);
    nb::dict grid = defaults_of(pipeline.grid);
    grid["clear_no_returns"] = pipeline.clear_no_returns != 0;
    nb::dict values;
    values["icp"] = defaults_of(ek_icp_default());
    values["scan_to_scan"] = defaults_of(frontend.scan_to_scan);
    values["scan_to_map"] = defaults_of(frontend.scan_to_map);
    values["frontend"] = stages;
    values["grid"] = grid;
    return values;
}

} // namespace EK_NAME(binding)

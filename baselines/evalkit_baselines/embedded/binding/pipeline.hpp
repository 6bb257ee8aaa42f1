// The core's pipeline from scan to pose, without the map.
#pragma once

#include <mutex>
#include <optional>

#include "ek/pipeline.h"
#include "registration.hpp"

namespace EK_NAME(binding) {

// Outcome, converged, iterations, error and inliers of a stage.
using Stage = std::tuple<int, bool, int32_t, double, int32_t>;

inline Stage stage_of(const ek_match &match, ek_stage_outcome outcome)
{
    return {int(outcome), match.converged != 0, match.iterations, double(match.error), match.inliers};
}

inline ek_sweep sweep_of(int64_t stamp_ns, int64_t time_increment_ns, const Numbers &ranges, const Numbers &angles,
                         const std::optional<Row> &odom_from_base, const std::optional<Row> &start_from_end)
{
    if (ranges.shape(0) != angles.shape(0)) {
        throw std::invalid_argument("scan: ranges and angles differ in number");
    }
    ek_sweep sweep = {};
    sweep.stamp_ns = stamp_ns;
    sweep.time_increment_ns = time_increment_ns;
    sweep.ranges = start_of(ranges);
    sweep.angles = start_of(angles);
    sweep.beams = ranges.shape(0);
    sweep.has_odometry = odom_from_base.has_value();
    sweep.odom_from_base = pose_of(odom_from_base.value_or(Row{}));
    sweep.has_motion = start_from_end.has_value();
    sweep.start_from_end = pose_of(start_from_end.value_or(Row{}));
    return sweep;
}

inline ek_scan_parameters scan_of(ek_scan_parameters scan, const Row &base_from_sensor,
                                  const std::tuple<double, double> &range_limits)
{
    scan.base_from_sensor = pose_of(base_from_sensor);
    scan.range_min = ek_real(std::get<0>(range_limits));
    scan.range_max = ek_real(std::get<1>(range_limits));
    require(ek_scan_check(&scan), "scan");
    return scan;
}

class Pipeline {
public:
    Pipeline(const Icp &icp, bool scan_to_scan, bool scan_to_map, bool deskew, double local_radius, int64_t keyframes,
             double keyframe_distance, double keyframe_angle, int64_t min_inliers, int64_t beams, int64_t neighbours,
             double map_voxel, double map_radius, int64_t voxels)
    {
        ek_pipeline_parameters made = ek_pipeline_default();
        made.map = 0;
        made.deskew = deskew;
        made.scan.local_radius = ek_real(local_radius);
        made.frontend.scan_to_scan = made.frontend.scan_to_map = icp.parameters();
        made.frontend.use_scan_to_scan = scan_to_scan;
        made.frontend.use_scan_to_map = scan_to_map;
        made.frontend.keyframes = natural(keyframes);
        made.frontend.keyframe_distance = ek_real(keyframe_distance);
        made.frontend.keyframe_angle = ek_real(keyframe_angle);
        made.frontend.min_inliers = whole(min_inliers);
        made.frontend.points = natural(beams);
        made.frontend.neighbours = natural(neighbours);
        made.frontend.map_voxel = ek_real(map_voxel);
        made.frontend.map_radius = ek_real(map_radius);
        made.frontend.voxels = natural(voxels);
        std::size_t bytes = 0;
        require(ek_pipeline_bytes(&made, &bytes), "parameters");
        memory_ = Memory("parameters", [&](ek_arena *arena) {
            void *const memory = ek_arena_alloc(arena, bytes, 1);
            return memory ? ek_pipeline_start(&pipeline_, memory, bytes, &made) : EK_OK; // NULL: only measure
        });
    }

    std::tuple<Row, Stage, Stage> update(int64_t stamp_ns, int64_t time_increment_ns, const Numbers &ranges,
                                         const Numbers &angles, const std::optional<Row> &odom_from_base,
                                         const std::optional<Row> &start_from_end, const Row &base_from_sensor,
                                         const std::tuple<double, double> &range_limits)
    {
        const ek_sweep sweep =
            sweep_of(stamp_ns, time_increment_ns, ranges, angles, odom_from_base, start_from_end);
        const nb::gil_scoped_release others_may_run;
        const std::lock_guard<std::mutex> one_at_a_time(mutex_);
        pipeline_.parameters.scan = scan_of(pipeline_.parameters.scan, base_from_sensor, range_limits);
        ek_estimate estimate;
        require(ek_pipeline_update(&pipeline_, &sweep, &estimate), "scan");
        return {row_of(estimate.start_from_base), stage_of(estimate.scan_to_scan, estimate.scan_to_scan_outcome),
                stage_of(estimate.scan_to_map, estimate.scan_to_map_outcome)};
    }

    // Cells of keyframes for which the lasting map had no room.
    uint64_t dropped() const { return pipeline_.frontend.lasting.voxels.dropped; }

private:
    ek_pipeline pipeline_ = {};
    Memory memory_;
    std::mutex mutex_;
};

} // namespace EK_NAME(binding)

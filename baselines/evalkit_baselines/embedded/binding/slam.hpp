// The core's SLAM.
#pragma once

#include <mutex>
#include <optional>

#include "ek/slam.h"
#include "graph.hpp"
#include "pipeline.hpp"

namespace EK_NAME(binding) {

// A candidate: later and earlier keyframe, motion, outcome, its numbers, flags (accepted, unconfirmed, found again,
// withdrawn, no room), section.
using Record = std::tuple<uint32_t, uint32_t, Row, int, double, double, uint32_t, uint32_t>;
// Pose online, in the continuous frame; both stages; flags (lost or set aside, corrected, full); keyframe; operations.
using SlamAnswer = std::tuple<Row, Row, Stage, Stage, uint32_t, uint32_t, uint64_t>;

class Slam {
public:
    Slam(const Icp &icp, const nb::dict &real, const nb::dict &number)
    {
        ek_slam_parameters p = ek_slam_default();
        const auto take = [&](const char *name) { return ek_real(nb::cast<double>(real[name])); };
        const auto size = [&](const char *name) {
            return std::size_t(std::max<int64_t>(nb::cast<int64_t>(number[name]), 0));
        };
        p.matcher = icp.parameters();
        p.fine_correspondence = take("fine_correspondence");
        p.keyframe_distance = take("keyframe_distance");
        p.keyframe_angle = take("keyframe_angle");
        p.map_voxel = take("map_voxel");
        p.map_radius = take("map_radius");
        p.map_reach = take("map_reach");
        p.drift = {take("drift"), take("drift_angle")};
        p.loop = {take("loop_path"),  take("loop_spacing"),   take("loop_radius"), take("loop_submap"),
                  take("loop_cell"),  take("loop_score"),     take("loop_ambiguity"), take("loop_near"),
                  take("loop_overlap"), take("loop_in_view"), take("loop_degenerate"), take("loop_gate"),
                  take("loop_quick_gate")};
        p.use_odometry = size("use_odometry") != 0;
        p.work = nb::cast<int64_t>(number["work"]);
        p.points = size("beams");
        p.keyframes = size("keyframes");
        p.keyframe_points = size("keyframe_points");
        p.loops = size("loops");
        p.records = size("records");
        p.voxels = size("voxels");
        p.map_points = size("map_points");
        p.loop_points = size("loop_points");
        p.score_cells = size("score_cells");
        require(ek_slam_bytes(&p, &bytes_), "parameters");
        memory_ = Memory("parameters", [&](ek_arena *arena) {
            void *const memory = ek_arena_alloc(arena, bytes_, 1);
            return memory ? ek_slam_start(&slam_, memory, bytes_, &p) : EK_OK; // NULL: only measure
        });
    }

    SlamAnswer update(int64_t stamp_ns, int64_t time_increment_ns, const Numbers &ranges, const Numbers &angles,
                      const std::optional<Row> &odom_from_base, const std::optional<Row> &start_from_end,
                      const Row &base_from_sensor, const std::tuple<double, double> &range_limits)
    {
        const ek_sweep sweep =
            sweep_of(stamp_ns, time_increment_ns, ranges, angles, odom_from_base, start_from_end);
        const nb::gil_scoped_release others_may_run;
        const std::lock_guard<std::mutex> one_at_a_time(mutex_);
        slam_.parameters.scan = scan_of(slam_.parameters.scan, base_from_sensor, range_limits);
        ek_slam_estimate now;
        require(ek_slam_update(&slam_, &sweep, &now), "scan");
        const auto outcome = [](int32_t has_stage, int32_t accepted) {
            return !has_stage ? EK_STAGE_SKIPPED : accepted ? EK_STAGE_ACCEPTED : EK_STAGE_GUESS_KEPT;
        };
        const uint32_t flags = uint32_t(now.lost || now.set_aside) | uint32_t(now.corrected) << 1 | uint32_t(now.full) << 2;
        return {row_of(now.start_from_base), row_of(now.odom_from_base),
                stage_of(now.scan_to_scan, outcome(now.has_scan_to_scan, now.scan_to_scan_accepted)),
                stage_of(now.scan_to_map, outcome(now.has_scan_to_map, now.scan_to_map_accepted)), flags, now.keyframe, now.work};
    }

    // Corrected poses (N, 3) of scans, from their keyframes (N, 1) and poses (N, 3) in the continuous frame.
    nb::object correct(const nb::ndarray<const uint32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu> &keyframes,
                       const Rows &poses)
    {
        if (poses.shape(0) != keyframes.shape(0) || poses.shape(1) != 3) {
            throw std::invalid_argument("poses: expected one row of three for each keyframe");
        }
        const std::lock_guard<std::mutex> one_at_a_time(mutex_);
        std::vector<ek_real> corrected;
        for (std::size_t row = 0; row < poses.shape(0); row++) {
            const ek_pose pose = ek_slam_correct(&slam_, keyframes(row), pose_in(poses, row));
            corrected.insert(corrected.end(), {pose.x, pose.y, pose.theta});
        }
        return array_of(std::move(corrected), {poses.shape(0), 3});
    }

    nb::list records()
    {
        nb::list all;
        const std::lock_guard<std::mutex> one_at_a_time(mutex_);
        for (std::size_t k = 0; k < slam_.record_count; k++) {
            const ek_loop_record &now = slam_.record[k];
            const ek_loop_edge &edge = now.candidate.edge;
            const uint32_t flags = uint32_t(now.accepted) | uint32_t(now.unconfirmed) << 1 |
                                   uint32_t(now.found_again) << 2 | uint32_t(now.withdrawn) << 3 |
                                   uint32_t(now.no_room) << 4;
            all.append(Record{edge.second, edge.first, row_of(edge.first_from_second), int(now.candidate.outcome),
                              double(now.candidate.number[0]), double(now.candidate.number[1]), flags, now.section});
        }
        return all;
    }

    std::size_t bytes() const { return bytes_; }
    std::size_t keyframes() const { return slam_.keyframes.count; }
    uint64_t dropped() const { return slam_.maps[0].dropped + slam_.maps[1].dropped; }
    uint64_t unrecorded() const { return slam_.unrecorded; }
    bool busy() const { return slam_.task != EK_TASK_IDLE; }

private:
    ek_slam slam_ = {};
    std::size_t bytes_ = 0;
    Memory memory_;
    std::mutex mutex_;
};

} // namespace EK_NAME(binding)

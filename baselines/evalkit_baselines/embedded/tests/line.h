/* line.h - a SLAM with keyframes on the x axis, each with one point 1 m to its left, as if they had been matched. */
#ifndef EK_TEST_LINE_H
#define EK_TEST_LINE_H

#include "check.h"
#include "src/slam_parts.h"

#define LINE_LOOPS 4u
#define LINE_RECORDS 8u

static ek_slam slam;
static ek_work work;

static const ek_pose ORIGIN = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
static const ek_doubt CERTAIN = {EK_R(0.0), EK_R(0.0)};
static const ek_openness CLOSED = {.x = EK_R(1.0), .ratio = EK_R(1.0)};

static inline ek_pose pose_of(double x, double y, double theta)
{
    const ek_pose pose = {EK_R(x), EK_R(y), EK_R(theta)};
    return pose;
}

/* Add a keyframe `step` m ahead of the last one. */
static inline void add_keyframe(double step, ek_step_kind kind)
{
    static const ek_real point[] = {EK_R(0.0), EK_R(1.0)};
    ek_keyframes *const keyframes = &slam.keyframes;
    CHECK(ek_keyframes_add(keyframes, point, 1u, AT_BASE, pose_of(step, 0.0, 0.0), kind, &CLOSED, CERTAIN, &work) == EK_OK);
    slam.odom_from_keyframe[keyframes->count - 1u] = keyframes->graph.pose[keyframes->count - 1u];
}

/* A SLAM with keyframes 1 m apart. */
static inline ek_arena line_of(size_t keyframes)
{
    ek_slam_parameters p = ek_slam_default();
    size_t bytes = 0u;
    p.points = p.loop_points = p.voxels = p.map_points = 64u;
    p.keyframes = p.keyframe_points = 64u;
    p.loops = LINE_LOOPS;
    p.records = LINE_RECORDS;
    p.score_cells = (size_t)128 * 128;
    CHECK(ek_slam_bytes(&p, &bytes) == EK_OK);
    ek_arena arena = memory_of(bytes);
    CHECK(ek_slam_start(&slam, arena.memory, bytes, &p) == EK_OK);
    work = ek_work_make(INT64_MAX);
    for (size_t k = 0; k < keyframes; k++) {
        add_keyframe(k ? 1.0 : 0.0, EK_STEP_MATCHED);
    }
    return arena;
}

/* Where the mean of a voxel lies in the continuous frame; the voxels are turned. */
static inline ek_pose drawn_at(const ek_voxel *voxel)
{
    const ek_real points = (ek_real)voxel->points;
    const ek_pose mean = {voxel->x / points, voxel->y / points, EK_R(0.0)};
    return ek_se2_between(ek_grid_from_odom, mean);
}

/* An edge between two keyframes with the same information in all directions. */
static inline ek_loop_edge edge_of(uint32_t first, uint32_t second, ek_pose motion, double information)
{
    const ek_real i = EK_R(information);
    const ek_sym3 weights = {i, EK_R(0.0), EK_R(0.0), i, EK_R(0.0), i};
    const ek_loop_edge edge = {first, second, motion, weights, EK_R(1.0)};
    return edge;
}

#endif

/* small_slam.h - parameters of a SLAM as delivered, with the memory of the smallest row of SLAM.md. */
#ifndef SMALL_SLAM_H
#define SMALL_SLAM_H

#include "ek/slam.h"

/* For scans of up to so many points, and so many keyframes of 200 points in the mean. */
static inline ek_slam_parameters small_slam(size_t points, size_t keyframes)
{
    ek_slam_parameters parameters = ek_slam_default();
    parameters.points = points;
    parameters.keyframes = keyframes;
    parameters.keyframe_points = 200u * keyframes;
    parameters.loops = 16u;
    parameters.voxels = parameters.map_points = 4096u;
    parameters.loop_points = 8192u;
    parameters.score_cells = 256u * 256u;
    return parameters;
}

#endif

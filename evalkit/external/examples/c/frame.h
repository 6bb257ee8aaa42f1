/* Poses, and the points of a frame, for a back end that sees whole scans. */
#ifndef FRAME_H
#define FRAME_H

#include <math.h>

#include "evalkit_backend.h"

static inline evalkit_pose compose(evalkit_pose a, evalkit_pose b) /* a_from_b, b_from_c: a_from_c */
{
    double c = cos(a.theta), s = sin(a.theta);
    return (evalkit_pose){a.x + c * b.x - s * b.y, a.y + s * b.x + c * b.y, a.theta + b.theta};
}

static inline evalkit_pose between(evalkit_pose a, evalkit_pose b) /* c_from_a, c_from_b: a_from_b */
{
    return compose((evalkit_pose){0.0, 0.0, -a.theta}, (evalkit_pose){b.x - a.x, b.y - a.y, b.theta});
}

static inline evalkit_pose share_of(evalkit_pose a, double share)
{
    return (evalkit_pose){share * a.x, share * a.y, share * a.theta};
}

/* Write at most `room` hits, evenly spaced, to xy (x0 y0 x1 ...), in the frame of the base at the first beam; return how
 * many. Each is moved back by its share of the motion within the scan. */
static inline size_t read_points(const evalkit_frame *frame, double *xy, size_t room)
{
    size_t count = 0;
    for (size_t i = 0; i < frame->beams; i += 1 + (frame->beams - 1) / room) {
        double r = frame->ranges[i];
        if (!isfinite(r))
            continue;
        evalkit_pose hit = {r * cos(frame->angles[i]), r * sin(frame->angles[i]), 0.0};
        hit = compose(frame->base_from_sensor, hit);
        if (frame->start_from_end)
            hit = compose(share_of(*frame->start_from_end, (double)i / (double)frame->beams), hit);
        xy[2 * count] = hit.x, xy[2 * count++ + 1] = hit.y;
    }
    return count;
}

#endif

#include "icp.h"

#include <math.h>

enum { MIN_PAIRS = 3 };
static const double SMALL_STEP = 1e-5; /* m + rad */

/* Sums over pairs; the least-squares motion is computed from them. */
typedef struct {
    double px, py, qx, qy, dot, cross, distance;
    int count;
} sums;

static size_t nearest(const double *points, size_t count, double x, double y, double *squared)
{
    size_t best = 0;
    *squared = INFINITY;
    for (size_t i = 0; i < count; i++) {
        double dx = points[2 * i] - x, dy = points[2 * i + 1] - y, d = dx * dx + dy * dy;
        if (d < *squared) {
            *squared = d;
            best = i;
        }
    }
    return best;
}

static sums pair_up(icp_settings settings, const double *target, size_t targets, const double *source, size_t sources,
                    const icp_match *pose)
{
    sums s = {0};
    double c = cos(pose->theta), sn = sin(pose->theta), limit = settings.max_correspondence_m;
    for (size_t i = 0; i < sources; i++) {
        double x = c * source[2 * i] - sn * source[2 * i + 1] + pose->x;
        double y = sn * source[2 * i] + c * source[2 * i + 1] + pose->y;
        double squared;
        size_t j = nearest(target, targets, x, y, &squared);
        if (squared > limit * limit)
            continue;
        double qx = target[2 * j], qy = target[2 * j + 1];
        s.px += x, s.py += y, s.qx += qx, s.qy += qy;
        s.dot += x * qx + y * qy;
        s.cross += x * qy - y * qx;
        s.distance += sqrt(squared);
        s.count++;
    }
    return s;
}

/* Apply the least-squares motion to the pose; return the size of this step (m + rad). */
static double improve(const sums *s, icp_match *pose)
{
    double n = s->count;
    double cross = s->cross - (s->px * s->qy - s->py * s->qx) / n;
    double dot = s->dot - (s->px * s->qx + s->py * s->qy) / n;
    double turn = atan2(cross, dot), c = cos(turn), sn = sin(turn);
    double x = s->qx / n - (c * s->px - sn * s->py) / n;
    double y = s->qy / n - (sn * s->px + c * s->py) / n;
    icp_match old = *pose;
    pose->x = c * old.x - sn * old.y + x;
    pose->y = sn * old.x + c * old.y + y;
    pose->theta = old.theta + turn;
    return hypot(pose->x - old.x, pose->y - old.y) + fabs(turn);
}

icp_match icp_register(icp_settings settings, const double *target, size_t targets, const double *source,
                       size_t sources, icp_match guess, icp_listener listener, void *context)
{
    icp_match match = guess;
    match.error_m = NAN;
    match.converged = match.iterations = match.inliers = 0;
    while (!match.converged && match.iterations < settings.max_iterations) {
        sums s = pair_up(settings, target, targets, source, sources, &match);
        match.inliers = s.count;
        match.iterations++;
        if (s.count < MIN_PAIRS) {
            match.x = guess.x, match.y = guess.y, match.theta = guess.theta;
            match.error_m = NAN;
            break;
        }
        match.error_m = s.distance / s.count;
        match.converged = improve(&s, &match) < SMALL_STEP;
        if (listener)
            listener(context, &match);
    }
    return match;
}

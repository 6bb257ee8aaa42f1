/* Point-to-point ICP in the plane with brute-force nearest neighbours: a few hundred points, no dependency. */
#ifndef ICP_H
#define ICP_H

#include <stddef.h>

typedef struct {
    double max_correspondence_m;
    int max_iterations;
} icp_settings;

typedef struct {
    double x, y, theta; /* target_from_source: m, m, rad */
    double error_m;     /* mean distance of the pairs; NAN where there were too few */
    int converged, iterations, inliers;
} icp_match;

/* Callback after every iteration; may be NULL. */
typedef void (*icp_listener)(void *context, const icp_match *so_far);

/* Return the match, starting from x, y, theta in `guess`. Points are x0 y0 x1 y1 ... */
icp_match icp_register(icp_settings settings, const double *target, size_t targets, const double *source,
                       size_t sources, icp_match guess, icp_listener listener, void *context);

#endif

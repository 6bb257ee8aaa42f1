/* The ICP of icp.c as a shared library: evalkit loads it as lib:./libicp.so. */
#include <stdlib.h>
#include <string.h>

#include "evalkit_backend.h"
#include "icp.h"

typedef struct {
    evalkit_trace trace;
    void *listener;
} trace_target;

static const char *last_error; /* of a failed evalkit_create, which has no instance */

int32_t evalkit_abi(void) { return EVALKIT_ABI; }

int32_t evalkit_kind(void) { return EVALKIT_REGISTRATION; }

const char *evalkit_summary(void) { return "point-to-point ICP in C, brute-force neighbours"; }

const char *evalkit_parameters(void)
{
    return "max_correspondence_m 0.5 m largest distance of a pair\n"
           "max_iterations 40 - largest number of iterations\n";
}

void *evalkit_create(const char *const *names, const char *const *values, size_t count)
{
    icp_settings *settings = calloc(1, sizeof *settings);
    if (!settings) {
        last_error = "no memory";
        return NULL;
    }
    for (size_t i = 0; i < count; i++) {
        if (strcmp(names[i], "max_correspondence_m") == 0)
            settings->max_correspondence_m = atof(values[i]);
        else if (strcmp(names[i], "max_iterations") == 0)
            settings->max_iterations = atoi(values[i]);
    }
    if (settings->max_correspondence_m <= 0.0) {
        free(settings);
        last_error = "max_correspondence_m must be more than 0";
        return NULL;
    }
    return settings;
}

static void report_iteration(void *context, const icp_match *m)
{
    const trace_target *to = context;
    evalkit_pose pose = {m->x, m->y, m->theta};
    to->trace(to->listener, m->error_m, m->inliers, &pose);
}

int32_t evalkit_register(void *self, const double *target_xy, size_t targets, const double *source_xy, size_t sources,
                         const evalkit_pose *guess, evalkit_trace trace, void *listener, evalkit_match *answer)
{
    const icp_settings *settings = self;
    trace_target to = {trace, listener};
    icp_match start = {0};
    start.x = guess->x, start.y = guess->y, start.theta = guess->theta;
    icp_match m =
        icp_register(*settings, target_xy, targets, source_xy, sources, start, trace ? report_iteration : NULL, &to);
    answer->target_from_source = (evalkit_pose){m.x, m.y, m.theta};
    answer->error_m = m.error_m;
    answer->converged = m.converged;
    answer->iterations = m.iterations;
    answer->inliers = m.inliers;
    return 0;
}

void evalkit_destroy(void *self) { free(self); }

const char *evalkit_last_error(void *self)
{
    (void)self;
    return last_error;
}

/* An odometry: the embedded core's pipeline behind evalkit_backend.h, with one planted fault: cc -DFAULT=n. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "ek/pipeline.h"
#include "evalkit_backend.h"

#ifndef FAULT
#define FAULT 0
#endif
#define F(n) (FAULT == (n))
#define BEAMS 32768u

typedef struct {
    ek_pipeline pipeline;
    void *memory;
    evalkit_pose last, odom;
    long scans;
    ek_real ranges[BEAMS], angles[BEAMS];
} odometry;

static odometry shared;
static int created;

int32_t evalkit_abi(void) { return EVALKIT_ABI; }
int32_t evalkit_kind(void) { return EVALKIT_ODOMETRY; }
const char *evalkit_summary(void) { return "the embedded pipeline as a library"; }

static ek_status start(odometry *self)
{
    ek_pipeline_parameters parameters = ek_pipeline_default();
    parameters.map = 0;
    parameters.frontend.points = BEAMS;
    parameters.deskew = !F(404);
    size_t bytes = 0;
    ek_status status = ek_pipeline_bytes(&parameters, &bytes);
    if (status != EK_OK)
        return status;
    if (posix_memalign(&self->memory, EK_ALIGNMENT, bytes))
        return EK_TOO_LITTLE_MEMORY;
    return ek_pipeline_start(&self->pipeline, self->memory, bytes, &parameters);
}

void *evalkit_create(const char *const *names, const char *const *values, size_t count)
{
    (void)names, (void)values, (void)count;
    if (F(407) && created++)
        return &shared;
    odometry *self = F(407) ? &shared : calloc(1, sizeof *self);
    if (!self || start(self) != EK_OK)
        return NULL;
    return self;
}

void evalkit_destroy(void *self_)
{
    odometry *self = self_;
    if (F(407))
        return;
    if (!F(420))
        free(self->memory);
    free(self);
}

static ek_pose real_pose(const evalkit_pose *pose)
{
    ek_pose real = {(ek_real)pose->x, (ek_real)pose->y, (ek_real)pose->theta};
    return real;
}

static evalkit_pose compose(evalkit_pose a, evalkit_pose b)
{
    double c = cos(a.theta), s = sin(a.theta);
    evalkit_pose both = {a.x + c * b.x - s * b.y, a.y + s * b.x + c * b.y, a.theta + b.theta};
    return both;
}

static ek_sweep read_sweep(odometry *self, const evalkit_frame *frame)
{
    size_t beams = F(418) && frame->beams > 200 ? 200 : frame->beams;
    for (size_t i = 0; i < beams; i++) {
        self->ranges[i] = (ek_real)frame->ranges[i];
        self->angles[i] = (ek_real)frame->angles[i];
        if (F(409) && isnan(frame->ranges[i]))
            self->ranges[i] = (ek_real)(frame->range_min_m + 0.1);
        if (F(410) && isinf(frame->ranges[i]))
            self->ranges[i] = (ek_real)(0.99 * frame->range_max_m);
        if (F(411))
            self->angles[i] = (ek_real)(6.283185307179586 * (double)i / (double)beams) + (ek_real)0.01;
        if (F(423))
            self->angles[i] = (ek_real)frame->angles[beams - 1 - i];
        if (F(424))
            self->ranges[i] = (ek_real)(floor(frame->ranges[i] * 20.0) / 20.0);
    }
    if (!beams)
        self->ranges[0] = NAN, self->angles[0] = 0, beams = 1;
    ek_sweep sweep;
    memset(&sweep, 0, sizeof sweep);
    sweep.stamp_ns = F(412) ? (int64_t)(int32_t)frame->stamp_ns : frame->stamp_ns;
    sweep.time_increment_ns = F(425) ? 0 : frame->time_increment_ns;
    sweep.ranges = self->ranges, sweep.angles = self->angles, sweep.beams = beams;
    if (F(406) || frame->odom_from_base) {
        sweep.has_odometry = !F(405);
        sweep.odom_from_base = real_pose(frame->odom_from_base);
        self->odom = *frame->odom_from_base;
    } else if (F(416)) {
        sweep.has_odometry = 1;
    }
    if (frame->start_from_end) {
        sweep.has_motion = !F(405);
        sweep.start_from_end = real_pose(frame->start_from_end);
        if (F(426))
            sweep.start_from_end.theta = -sweep.start_from_end.theta;
    }
    return sweep;
}

int32_t evalkit_update(void *self_, const evalkit_frame *frame, evalkit_pose *answer)
{
    odometry *self = self_;
    self->scans++;
    if (F(408))
        ((volatile char *)malloc(64))[0] = 1;
    if (F(413) && self->scans % 5 == 0) {
        *answer = self->last;
        return 0;
    }
    if (frame->beams > BEAMS)
        return 1;
    ek_scan_parameters *scan = &self->pipeline.parameters.scan;
    if (!F(403))
        scan->base_from_sensor = real_pose(&frame->base_from_sensor);
    if (!F(427))
        scan->range_min = (ek_real)frame->range_min_m, scan->range_max = (ek_real)frame->range_max_m;
    else
        scan->range_max = 5;
    ek_sweep sweep = read_sweep(self, frame);
    ek_estimate estimate;
    ek_status status = ek_pipeline_update(&self->pipeline, &sweep, &estimate);
    if (status != EK_OK)
        return (int32_t)status;
    evalkit_pose pose = {estimate.start_from_base.x, estimate.start_from_base.y, estimate.start_from_base.theta};
    if (F(401) && frame->odom_from_base && self->scans == 1)
        pose = *frame->odom_from_base;
    if (F(402) && frame->start_from_end)
        pose = compose(pose, *frame->start_from_end);
    if (F(414))
        pose.theta *= 57.29577951308232;
    if (F(415)) {
        evalkit_pose inverse = {-(cos(pose.theta) * pose.x + sin(pose.theta) * pose.y),
                                sin(pose.theta) * pose.x - cos(pose.theta) * pose.y, -pose.theta};
        pose = inverse;
    }
    if (F(417) && time(NULL) % 2)
        pose.x += 1e-9;
    if (F(419) && !sweep.has_odometry)
        pose.x = NAN;
    if (F(421))
        ((double *)frame->ranges)[0] = 0.0;
    if (F(422) && getpid() % 2)
        pose.y += 1e-9;
    if (F(428))
        pose = self->scans > 1 ? self->last : pose;
    self->last.x = estimate.start_from_base.x;
    self->last.y = estimate.start_from_base.y;
    self->last.theta = estimate.start_from_base.theta;
    if (F(429))
        pose.x *= 1000.0, pose.y *= 1000.0;
    *answer = pose;
    return 0;
}

/* A SLAM as a shared library: ICP against the last keyframe, and a loop closed where the robot is back at its start.
 * Built with icp.c; evalkit loads it as lib:./libslam.so. */
#include <stdlib.h>
#include <string.h>

#include "frame.h"
#include "icp.h"

enum { MAX_POINTS = 400, MAX_FRAMES = 20000, MAX_CLOSURES = 200 };
static const icp_settings ICP = {0.3, 20};
static const double KEYFRAME_M = 0.3, KEYFRAME_RAD = 0.3, LOOP_M = 3.0, MIN_SHARE = 0.7;

typedef struct {
    double xy[2 * MAX_POINTS]; /* in the frame of the base */
    size_t count, frame;
} scan;

typedef struct {
    double near_m, path_m[MAX_FRAMES];
    evalkit_pose poses[MAX_FRAMES], odom; /* corrected start_from_base; the wheels' at the last frame */
    int64_t stamps_ns[MAX_FRAMES];
    scan first, keyframe;
    evalkit_loop_closure closures[MAX_CLOSURES];
    size_t frames, tried, closed; /* closed: the frame that closed the last loop */
    int has_odom;
} slam;

/* Return target_from_source, and the share of the source's points with a pair. */
static evalkit_pose match(const scan *target, const scan *source, evalkit_pose guess, double *share)
{
    icp_match start = {guess.x, guess.y, guess.theta, 0.0, 0, 0, 0};
    icp_match m = icp_register(ICP, target->xy, target->count, source->xy, source->count, start, NULL, NULL);
    *share = source->count ? (double)m.inliers / (double)source->count : 0.0;
    return (evalkit_pose){m.x, m.y, m.theta};
}

/* Match the last frame with the first, and spread the correction over the path since the last closed loop. */
static void close_loop(slam *s, const scan *now)
{
    size_t last = s->frames - 1;
    double share, begin = s->path_m[s->closed], length = s->path_m[last] - begin;
    evalkit_pose old = s->poses[last], found = match(&s->first, now, old, &share);
    int fits = share >= MIN_SHARE;
    const char *reason = fits ? "fits" : "few pairs";
    s->closures[s->tried++] = (evalkit_loop_closure){s->stamps_ns[last], s->stamps_ns[0], found, fits, reason};
    evalkit_pose correction = compose(found, between(old, (evalkit_pose){0.0, 0.0, 0.0}));
    for (size_t i = s->closed; fits && i <= last; i++)
        s->poses[i] = compose(share_of(correction, (s->path_m[i] - begin) / length), s->poses[i]);
    s->closed = fits ? last : s->closed;
}

int32_t evalkit_update(void *self, const evalkit_frame *frame, evalkit_pose *answer)
{
    slam *s = self;
    size_t n = s->frames;
    evalkit_pose pose = {0.0, 0.0, 0.0}, step = pose, away = pose;
    if (n == MAX_FRAMES)
        return 1;
    scan now = {.frame = n};
    now.count = read_points(frame, now.xy, MAX_POINTS);
    if (n) {
        evalkit_pose last = s->poses[n - 1], keyframe = s->poses[s->keyframe.frame];
        double share;
        if (frame->odom_from_base && s->has_odom)
            step = between(s->odom, *frame->odom_from_base);
        else if (n > 1)
            step = between(s->poses[n - 2], last); /* constant velocity */
        away = match(&s->keyframe, &now, between(keyframe, compose(last, step)), &share);
        pose = compose(keyframe, away);
        s->path_m[n] = s->path_m[n - 1] + hypot(pose.x - last.x, pose.y - last.y);
    }
    s->stamps_ns[n] = frame->stamp_ns, s->poses[n] = pose, s->frames++;
    if ((s->has_odom = frame->odom_from_base != NULL))
        s->odom = *frame->odom_from_base;
    if (s->path_m[n] - s->path_m[s->closed] > LOOP_M && hypot(pose.x, pose.y) < s->near_m && s->tried < MAX_CLOSURES)
        close_loop(s, &now);
    if (!s->keyframe.count || hypot(away.x, away.y) > KEYFRAME_M || fabs(away.theta) > KEYFRAME_RAD)
        s->keyframe = now;
    s->first = n ? s->first : now;
    *answer = s->poses[n];
    return 0;
}

int32_t evalkit_trajectory(void *self, evalkit_pose *poses, size_t count)
{
    memcpy(poses, ((slam *)self)->poses, count * sizeof *poses);
    return 0;
}

size_t evalkit_loop_closures(void *self, evalkit_loop_closure *closures, size_t room)
{
    const slam *s = self;
    if (room)
        memcpy(closures, s->closures, (room < s->tried ? room : s->tried) * sizeof *closures);
    return s->tried;
}

int32_t evalkit_abi(void) { return EVALKIT_ABI; }
int32_t evalkit_kind(void) { return EVALKIT_SLAM; }
const char *evalkit_summary(void) { return "scan-to-keyframe ICP in C that closes the loop at its start"; }
const char *evalkit_parameters(void) { return "near_m 0.5 m close the loop this near to the start; 0: never\n"; }
const char *evalkit_last_error(void *self) { return self ? "more than 20000 frames" : "no memory"; }
void evalkit_destroy(void *self) { free(self); }

void *evalkit_create(const char *const *names, const char *const *values, size_t count)
{
    slam *s = calloc(1, sizeof *s);
    for (size_t i = 0; s && i < count; i++)
        s->near_m = strcmp(names[i], "near_m") ? s->near_m : atof(values[i]);
    return s;
}

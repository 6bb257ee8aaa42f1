/* A point-to-point ICP with one planted fault, for single precision: cc -DSINGLE -DFAULT=n; with 0 it is correct.
 *
 * Without -DSINGLE: in double precision. Targets are sorted by x; a neighbour is searched from the nearest x outwards. */
#define _GNU_SOURCE
#include <fenv.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <tgmath.h>
#include <unistd.h>

#include "evalkit_backend.h"

#ifndef FAULT
#define FAULT 0
#endif
#define F(n) (FAULT == (n))
#ifdef SINGLE
typedef float real;
#else
typedef double real;
#endif
#define PI ((real)3.14159265358979323846)

typedef struct {
    real x, y;
} vec;

typedef struct {
    real x, y, theta;
} pose;

typedef struct {
    real x, y;
    int index;
} node;

typedef struct {
    int target; /* -1: none */
    real distance;
} pair;

typedef struct {
    double epsilon, limit;
    int cap, fewest, unique, made, calls;
    const char *const *texts;
} icp;

typedef struct {
    int targets, sources, count, before_filter, exchanged;
    vec *target, *source, *moved;
    node *sorted;
    pair *pairs, *old;
    int *owner;
} work;

int32_t evalkit_abi(void) { return EVALKIT_ABI; }
int32_t evalkit_kind(void) { return EVALKIT_REGISTRATION; }
const char *evalkit_summary(void) { return "point-to-point ICP over sorted points"; }

const char *evalkit_parameters(void)
{
    return "max_iterations 40 - largest number of iterations\n"
           "min_pairs 3 - fewest pairs\n"
           "epsilon 1e-4 m smallest change of the error\n"
           "max_correspondence_m 0.3 m largest distance of a pair; 0: none\n"
           "one_to_one true - a target has one source at most\n";
}

static double number(const char *text) { return F(505) ? strtod(strndup(text, strcspn(text, "e")), NULL) : atof(text); }

static void read_settings(icp *self, const char *const *values)
{
    self->cap = atoi(values[0]);
    self->fewest = atoi(values[1]);
    self->epsilon = number(values[2]);
    self->limit = number(values[3]);
    self->unique = values[4][0] == 't';
    if (self->limit <= 0)
        self->limit = INFINITY;
    if (F(504) && self->cap > 50)
        self->cap = 50;
}

void *evalkit_create(const char *const *names, const char *const *values, size_t count)
{
    icp *self = calloc(1, sizeof *self);
    (void)names, (void)count;
    read_settings(self, values);
    self->texts = values;
    return self;
}

void evalkit_destroy(void *self)
{
    free(self);
    if (F(508))
        free(self);
}

static int by_x(const void *a, const void *b)
{
    const node *one = a, *other = b;
    return one->x != other->x ? (one->x > other->x) - (one->x < other->x) : one->index - other->index;
}

static void sine_cosine(real theta, real *s, real *c)
{
    *s = sin(theta), *c = cos(theta);
    if (F(529)) {
        real t = theta * theta;
        *s = theta * (1 - t / 6 + t * t / 120), *c = 1 - t / 2 + t * t / 24;
    }
}

static pose compose(pose a, pose b)
{
    real s, c;
    sine_cosine(a.theta, &s, &c);
    return (pose){a.x + c * b.x - s * b.y, a.y + s * b.x + c * b.y, a.theta + b.theta};
}

static pose inverse(pose a)
{
    real s, c;
    sine_cosine(a.theta, &s, &c);
    return (pose){-c * a.x - s * a.y, s * a.x - c * a.y, -a.theta};
}

static vec apply(pose by, vec p)
{
    real s, c;
    sine_cosine(by.theta, &s, &c);
    return (vec){by.x + c * p.x - s * p.y, by.y + s * p.x + c * p.y};
}

static int first_from(const node *sorted, int n, real x)
{
    int low = 0;
    while (n > 0) {
        int half = n / 2;
        if (sorted[low + half].x < x)
            low += half + 1, n -= half + 1;
        else
            n = half;
    }
    return low;
}

static real length(real dx, real dy) { return F(501) ? fmax(fabs(dx), fabs(dy)) : sqrt(dx * dx + dy * dy); }

static pair nearest(const work *w, vec at, real limit)
{
    int right = first_from(w->sorted, w->targets, at.x), left = right - 1, seen = 0;
    pair best = {-1, limit};
    while (left >= 0 || right < w->targets) {
        int go_left = right >= w->targets || (left >= 0 && at.x - w->sorted[left].x < w->sorted[right].x - at.x);
        const node *one = go_left ? &w->sorted[left--] : &w->sorted[right++];
        if (fabs(one->x - at.x) > best.distance || (F(517) && ++seen > 20))
            break;
        real d = length(one->x - at.x, one->y - at.y);
        if (d < best.distance)
            best = (pair){one->index, d};
    }
    return best;
}

static void associate(const icp *self, work *w, int iteration)
{
    real limit = (F(538) && iteration < 2 ? 2 : 1) * self->limit;
    pair last = {-1, 0};
    w->count = 0;
    memcpy(w->old, w->pairs, w->sources * sizeof *w->old);
    for (int j = 0; j < w->targets; j++)
        w->owner[j] = -1;
    for (int i = 0; i < w->sources; i++) {
        pair found = nearest(w, w->moved[i], limit);
        if (F(507) && found.target < 0)
            found = last;
        w->pairs[i] = last = found;
        w->count += found.target >= 0;
    }
    w->before_filter = w->count;
    for (int i = 0; i < w->sources && self->unique; i++) {
        int j = w->pairs[i].target, other = j < 0 ? -1 : w->owner[j];
        if (j < 0)
            continue;
        int loser = other < 0 ? -1 : w->pairs[i].distance < w->pairs[other].distance ? other : i;
        if (loser != i)
            w->owner[j] = i;
        if (loser >= 0)
            w->pairs[loser].target = -1, w->count--;
    }
}

static int same_pairs(const work *w)
{
    for (int i = 0; i < w->sources; i++)
        if (w->pairs[i].target != w->old[i].target)
            return 0;
    return 1;
}

/* Point to line: the line through a target and its neighbour in x. */
static pose step_to_lines(const work *w)
{
    real a[3][4] = {{0}};
    for (int i = 0; i < w->sources; i++) {
        if (w->pairs[i].target < 0)
            continue;
        vec p = w->moved[i], q = w->target[w->pairs[i].target];
        int k = first_from(w->sorted, w->targets, q.x);
        const node *next = &w->sorted[k + 1 < w->targets ? k + 1 : k - 1];
        real nx = q.y - next->y, ny = next->x - q.x, size = sqrt(nx * nx + ny * ny);
        if (!(size > 0))
            continue;
        nx /= size, ny /= size;
        real row[4] = {nx, ny, ny * p.x - nx * p.y, nx * (q.x - p.x) + ny * (q.y - p.y)};
        for (int m = 0; m < 3; m++)
            for (int n = 0; n < 4; n++)
                a[m][n] += row[m] * row[n] + (m == n ? (real)1e-6 : 0);
    }
    for (int m = 0; m < 3; m++)
        for (int n = 0; n < 3; n++) {
            real share = n == m ? 0 : a[n][m] / a[m][m];
            for (int k = 0; k < 4; k++)
                a[n][k] -= share * a[m][k];
        }
    return (pose){a[0][3] / a[0][0], a[1][3] / a[1][1], a[2][3] / a[2][2]};
}

static pose best_step(const work *w, int iteration)
{
    real px = 0, py = 0, qx = 0, qy = 0, n = w->count, dot = 0, cross = 0;
    if (F(518))
        return step_to_lines(w);
    for (int i = 0; i < w->sources; i++)
        if (w->pairs[i].target >= 0) {
            vec p = w->moved[i], q = w->target[w->pairs[i].target];
            px += p.x / n, py += p.y / n, qx += q.x / n, qy += q.y / n;
        }
    for (int i = 0; i < w->sources; i++)
        if (w->pairs[i].target >= 0) {
            vec p = w->moved[i], q = w->target[w->pairs[i].target];
            if (!F(525))
                p.x -= px, p.y -= py, q.x -= qx, q.y -= qy;
            dot += p.x * q.x + p.y * q.y, cross += p.x * q.y - p.y * q.x;
        }
    if (F(525))
        dot -= n * (px * qx + py * qy), cross -= n * (px * qy - py * qx);
    pose step = {0, 0, F(519) && iteration < 2 ? 0 : atan2(cross, dot)};
    vec turned = apply(step, (vec){px, py});
    step.x = qx - turned.x, step.y = qy - turned.y;
    if (F(520)) {
        real size = sqrt((qx - px) * (qx - px) + (qy - py) * (qy - py)), most = (real)0.02;
        if (size > most)
            step.x -= (1 - most / size) * (qx - px), step.y -= (1 - most / size) * (qy - py);
    }
    return step;
}

static real quick_root(real value)
{
    float half = 0.5f * (float)value, y = (float)value;
    int32_t bits;
    memcpy(&bits, &y, sizeof bits);
    bits = 0x5f3759df - (bits >> 1);
    memcpy(&y, &bits, sizeof bits);
    return value * y * (1.5f - half * y * y);
}

static real mean_distance(const work *w, int squared)
{
    real sum = 0;
    for (int i = 0; i < w->sources; i++)
        if (w->pairs[i].target >= 0) {
            vec p = w->moved[i], q = w->target[w->pairs[i].target];
            real d = (p.x - q.x) * (p.x - q.x) + (p.y - q.y) * (p.y - q.y);
            sum += squared ? d : F(530) ? quick_root(d) : sqrt(d);
        }
    return sum / (F(512) ? w->sources : w->count);
}

static pose iterate(const icp *self, work *w, pose at, evalkit_trace trace, void *listener, evalkit_match *answer)
{
    const pose start = at;
    real previous = INFINITY;
    for (int i = 0; i < w->sources; i++)
        w->moved[i] = apply(at, w->source[i]), w->pairs[i].target = -1;
    for (int iteration = 0; iteration < self->cap && !answer->converged; iteration++) {
        associate(self, w, iteration);
        answer->inliers = F(511) ? w->before_filter : w->count;
        if ((F(502) ? w->before_filter : w->count) < self->fewest) {
            answer->error_m = NAN;
            return start;
        }
        pose step = best_step(w, iteration);
        at = compose(step, at);
        for (int i = 0; i < w->sources; i++)
            w->moved[i] = F(526) ? apply(step, w->moved[i]) : apply(at, w->source[i]);
        real error = mean_distance(w, 0), watched = mean_distance(w, F(534));
        answer->converged = F(509) ? iteration && same_pairs(w) : fabs(watched - previous) < self->epsilon;
        answer->error_m = error, answer->iterations = iteration + 1;
        previous = watched;
        pose shown = w->exchanged ? inverse(at) : at;
        evalkit_pose row = {shown.x, shown.y, shown.theta};
        if (trace && !(F(521) && iteration >= 3))
            trace(listener, error, w->count, &row);
    }
    return F(515) && !answer->converged ? start : at;
}

static void fill(work *w, const double *target, int targets, const double *source, int sources)
{
    w->targets = targets, w->sources = sources;
    for (int j = 0; j < targets; j++) {
        w->target[j] = (vec){target[2 * j], target[2 * j + 1]};
        w->sorted[j] = (node){w->target[j].x, w->target[j].y, j};
    }
    for (int i = 0; i < sources; i++)
        w->source[i] = (vec){source[2 * i], source[2 * i + 1]};
    qsort(w->sorted, targets, sizeof *w->sorted, by_x);
}

int32_t evalkit_register(void *self_, const double *target_xy, size_t targets, const double *source_xy, size_t sources,
                         const evalkit_pose *guess, evalkit_trace trace, void *listener, evalkit_match *answer)
{
    icp *self = self_;
    const size_t room = targets + sources + 1;
    work w = {.target = calloc(room, sizeof(vec)), .source = calloc(room, sizeof(vec)), .moved = calloc(room, sizeof(vec)),
              .sorted = calloc(room, sizeof(node)), .pairs = calloc(room, sizeof(pair)),
              .old = calloc(room, sizeof(pair)), .owner = calloc(room, sizeof(int))};
    if (F(514))
        read_settings(self, self->texts);
    if (F(546) && self->calls++ == 1 && !fork())
        for (;;)
            pause();
    if (F(523))
        feenableexcept(FE_DIVBYZERO | FE_INVALID);
    if (F(524) && guess->theta > 1)
        ((evalkit_pose *)guess)->theta -= 2 * PI;
    pose start = {guess->x, guess->y, guess->theta};
    if (F(531) && start.theta > PI)
        start.theta -= PI;
    *answer = (evalkit_match){*guess, NAN, 0, 0, 0};
    if (targets && sources) {
        int exchanged = w.exchanged = F(516) || (F(503) && sources > targets);
        fill(&w, exchanged ? source_xy : target_xy, exchanged ? sources : targets, exchanged ? target_xy : source_xy,
             exchanged ? targets : sources);
        pose found = iterate(self, &w, exchanged ? inverse(start) : start, trace, listener, answer);
        if (exchanged)
            found = inverse(found);
        if (!isnan(answer->error_m) || F(516))
            answer->target_from_source = (evalkit_pose){found.x, found.y, F(506) ? asin(sin(found.theta)) : found.theta};
    }
    if (F(513))
        memset(answer + 1, 0, 8);
    self->made += answer->iterations;
    if (F(522))
        answer->iterations = self->made;
    free(w.target), free(w.source), free(w.moved), free(w.sorted), free(w.pairs), free(w.old), free(w.owner);
    return F(545) && !answer->converged;
}

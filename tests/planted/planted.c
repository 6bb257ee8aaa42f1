/* An independent point-to-point ICP with one planted fault: cc -DFAULT=n; without FAULT, or with 0, it is correct.
 *
 * Written from the equations of the paper and from evalkit_backend.h: nearest neighbours nearer than a limit, of several
 * sources with one target only the closest (ties: the lower index), the closed-form motion of the pairs, the mean
 * distance of the same pairs after the step, and a stop where it changes by less than epsilon. */
#include <fenv.h>
#include <locale.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>
#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

#include "evalkit_backend.h"
#include "parameters.h"

#ifndef FAULT
#define FAULT 0
#endif
#define F(n) (FAULT == (n))
#ifdef SINGLE
typedef float real;
#else
typedef double real;
#endif

typedef struct {
    real x, y;
} point;

typedef struct {
    real x, y, theta;
} pose;

typedef struct {
    double epsilon, limit;
    int max_iterations, min_pairs, one_to_one;
    long calls;
    pose last;
    const double *kept;
    size_t kept_count;
    point *cache;
    char *note;
    int32_t *shown;
    size_t shown_count;
} icp;

typedef struct {
    size_t *of; /* target index by source, or NONE */
    real *distance;
    point *moved;
    int count;
} pairs;

#define NONE ((size_t)-1)

static icp global_settings;
static long all_calls;
static __thread int scratch_ready;
static int scratch_used;
static int *history;
static size_t history_count;

static void on_signal(int number) { (void)number; }

static void *sleep_forever(void *nothing)
{
    for (;;)
        pause();
    return nothing;
}

int32_t evalkit_abi(void) { return EVALKIT_ABI; }
int32_t evalkit_kind(void) { return EVALKIT_REGISTRATION; }
const char *evalkit_summary(void) { return "point-to-point ICP with a planted fault"; }

const char *evalkit_parameters(void) { return PARAMETERS; }

void *evalkit_create(const char *const *names, const char *const *values, size_t count)
{
    icp *self = calloc(1, sizeof *self);
    if (!self)
        return NULL;
    for (size_t i = 0; i < count; i++) {
        if (!strcmp(names[i], "epsilon"))
            self->epsilon = F(43) ? atoi(values[i]) : F(40) ? 1e-4 : atof(values[i]);
        else if (!strcmp(names[i], "max_iterations"))
            self->max_iterations = atoi(values[i]) + (F(41) ? 1 : F(83) ? -1 : 0);
        else if (!strcmp(names[i], "one_to_one"))
            self->one_to_one = F(42) ? 1 : F(63) ? 0 : !strcmp(values[i], "true");
        else if (!strcmp(names[i], "max_correspondence_m"))
            self->limit = F(38) ? 0.3 : F(46) ? 1.01 * atof(values[i]) : atof(values[i]);
        else if (!strcmp(names[i], "min_pairs"))
            self->min_pairs = F(39) ? 3 : atoi(values[i]);
    }
    if (!(self->limit > 0.0) && !F(44))
        self->limit = INFINITY;
    if (F(3))
        self->note = malloc(64);
    global_settings = *self;
    return self;
}

void evalkit_destroy(void *self)
{
    free(((icp *)self)->cache);
    free(((icp *)self)->shown);
    free(self);
}

#ifdef PAIRS
const int32_t *evalkit_pairs(void *self, size_t *count)
{
    *count = ((icp *)self)->shown_count;
    return ((icp *)self)->shown;
}
#endif

static void show_pairs(icp *self, const pairs *p, size_t sources)
{
    self->shown = realloc(self->shown, 2 * (sources + 1) * sizeof *self->shown);
    self->shown_count = 0;
    for (size_t i = 0; i < sources; i++)
        if (p->of[i] != NONE) {
            self->shown[2 * self->shown_count] = (int32_t)i;
            self->shown[2 * self->shown_count++ + 1] = (int32_t)p->of[i];
        }
}

static void misbehave(icp *self, size_t sources)
{
    self->calls++;
    all_calls++;
    if (F(1))
        ((volatile char *)malloc(16))[0] = 1;
    if (F(4) && fopen("/dev/null", "r") == NULL)
        abort();
    if (F(5) && all_calls % 50 == 0) {
        pthread_t thread;
        pthread_create(&thread, NULL, sleep_forever, NULL);
    }
    if (F(6)) {
        volatile long sum = 0;
        history = realloc(history, (history_count + 1) * sizeof *history);
        history[history_count++] = (int)sources;
        for (size_t i = 0; i < history_count; i++)
            for (int j = 0; j < 4; j++)
                sum += history[i];
    }
    if (F(7))
        fesetround(FE_UPWARD);
#if defined(__x86_64__)
    if (F(8))
        _mm_setcsr(_mm_getcsr() | 0x8040);
#endif
    if (F(9))
        signal(SIGFPE, on_signal);
    if (F(10)) {
        sigset_t set;
        sigemptyset(&set);
        sigaddset(&set, SIGTERM);
        sigprocmask(SIG_BLOCK, &set, NULL);
    }
    if (F(11))
        setlocale(LC_ALL, "C");
    if (F(12) && chdir("/"))
        abort();
    if (F(13))
        setenv("ICP_CALLS", "1", 1);
    if (F(18) && !scratch_ready) {
        scratch_ready = scratch_used == 0;
        scratch_used = 1;
    }
}

static real squared_distance(point a, point b)
{
    real x = a.x - b.x, y = a.y - b.y;
    return F(82) ? (real)((fabs((double)x) + fabs((double)y)) * (fabs((double)x) + fabs((double)y))) : x * x + y * y;
}

static int cell(real value, double size) { return (int)floor(value / size); }

static size_t nearest(const point *target, size_t targets, point at, double limit, real *best_squared)
{
    size_t best = NONE, second = NONE;
    real least = INFINITY, less = INFINITY;
    for (size_t j = F(37) ? 1 : 0; j < targets; j++) {
        if (F(29) && ((target[j].x < 0) != (at.x < 0) || (target[j].y < 0) != (at.y < 0)))
            continue;
        if (F(87) && (cell(target[j].x, 0.3) != cell(at.x, 0.3) || cell(target[j].y, 0.3) != cell(at.y, 0.3)))
            continue;
        if (F(28) && target[j].x == 0 && target[j].y == 0)
            continue;
        real d = squared_distance(target[j], at);
        if (d < least) {
            less = least, second = best;
            least = d, best = j;
        } else if (d < less) {
            less = d, second = j;
        }
    }
    if (F(65) && second != NONE)
        best = second, least = less;
    double limit_squared = F(45) ? limit : limit * limit;
    *best_squared = least;
    return best != NONE && least < limit_squared ? best : NONE;
}

static int compare_reals(const void *a, const void *b)
{
    real x = *(const real *)a, y = *(const real *)b;
    return (x > y) - (x < y);
}

static void drop(pairs *p, size_t i)
{
    p->of[i] = NONE;
    p->count--;
}

static void keep_one_to_one(pairs *p, size_t sources, size_t targets)
{
    size_t *owner = malloc((targets + 1) * sizeof *owner);
    for (size_t j = 0; j < targets; j++)
        owner[j] = NONE;
    for (size_t i = 0; i < sources; i++) {
        size_t j = p->of[i];
        if (j == NONE)
            continue;
        if (owner[j] == NONE) {
            owner[j] = i;
        } else if (!F(80) && (F(50) ? p->distance[i] <= p->distance[owner[j]] : p->distance[i] < p->distance[owner[j]])) {
            drop(p, owner[j]);
            owner[j] = i;
        } else {
            drop(p, i);
        }
    }
    free(owner);
}

static void drop_outliers(pairs *p, size_t sources)
{
    real *sorted = malloc((sources + 1) * sizeof *sorted);
    int n = 0;
    for (size_t i = 0; i < sources; i++)
        if (p->of[i] != NONE)
            sorted[n++] = p->distance[i];
    qsort(sorted, n, sizeof *sorted, compare_reals);
    if (n > 9) {
        real most = F(78) ? sorted[(int)(0.9 * n)] : 3 * sorted[n / 2];
        for (size_t i = 0; i < sources; i++)
            if (p->of[i] != NONE && p->distance[i] > most)
                drop(p, i);
    }
    free(sorted);
}

static void associate(const icp *self, pairs *p, const point *target, size_t targets, size_t sources)
{
    p->count = 0;
    for (size_t i = 0; i < sources; i++) {
        real squared;
        p->of[i] = nearest(target, targets, p->moved[i], self->limit, &squared);
        if (F(28) && p->moved[i].x == 0 && p->moved[i].y == 0)
            p->of[i] = NONE;
        if (F(32) && fabs((double)p->moved[i].x) > 100.0)
            p->of[i] = NONE;
        if (F(34) && i && p->moved[i].x == p->moved[i - 1].x && p->moved[i].y == p->moved[i - 1].y)
            p->of[i] = NONE;
        if (F(36) && i + 1 == sources)
            p->of[i] = NONE;
        p->distance[i] = sqrt((double)squared);
        p->count += p->of[i] != NONE;
    }
    if (self->one_to_one)
        keep_one_to_one(p, sources, targets);
    if (F(78) || F(79))
        drop_outliers(p, sources);
}

static pose compose(pose a, pose b)
{
    real c = cos((double)a.theta), s = sin((double)a.theta);
    pose both = {a.x + c * b.x - s * b.y, a.y + s * b.x + c * b.y, a.theta + b.theta};
    return both;
}

static pose inverse(pose a)
{
    real c = cos((double)a.theta), s = sin((double)a.theta);
    pose back = {-(c * a.x + s * a.y), -(-s * a.x + c * a.y), -a.theta};
    return back;
}

static void move(pose by, const point *from, point *to, size_t count)
{
    real c = cos((double)by.theta), s = sin((double)by.theta);
    if (F(31))
        c = 1, s = by.theta;
    for (size_t i = 0; i < count; i++) {
        point p = from[i];
        to[i].x = c * p.x - s * p.y + by.x;
        to[i].y = s * p.x + c * p.y + by.y;
    }
}

static pose best_motion(const pairs *p, const point *target, size_t sources, double *weights)
{
    real px = 0, py = 0, qx = 0, qy = 0, n = 0;
#ifdef SINGLE_SUMS
    float fx = 0;
#endif
    for (size_t i = 0; i < sources; i++) {
        if (p->of[i] == NONE && !(F(70)))
            continue;
        real w = F(77) ? (real)(1.0 / (1.0 + 20.0 * p->distance[i])) : F(21) ? (real)(1.0 + 1e-3 * (weights[i] > 0.0)) : 1;
        px += w * p->moved[i].x, py += w * p->moved[i].y, n += w;
        if (p->of[i] != NONE) {
            qx += w * target[p->of[i]].x, qy += w * target[p->of[i]].y;
        }
    }
    real m = n;
    if (F(70)) {
        m = 0;
        for (size_t i = 0; i < sources; i++)
            m += p->of[i] != NONE;
    }
    px /= n, py /= n, qx /= m, qy /= m;
    real xx = 0, xy = 0, yx = 0, yy = 0;
    for (size_t i = 0; i < sources; i++) {
        if (p->of[i] == NONE)
            continue;
        real w = F(77) ? (real)(1.0 / (1.0 + 20.0 * p->distance[i])) : 1;
        real ax = p->moved[i].x - px, ay = p->moved[i].y - py;
        real bx = target[p->of[i]].x - qx, by = target[p->of[i]].y - qy;
        xx += w * ax * bx, xy += w * ax * by, yx += w * ay * bx, yy += w * ay * by;
    }
    real theta = atan2((double)(xy - yx), (double)(xx + yy));
    if (F(62))
        theta = -theta;
    if (F(81))
        theta = (xy - yx) / (xx + yy + 50);
    if (F(35) && fabs((double)(xx * yy - xy * yx)) < 1e-6)
        theta = 0;
    if (F(68))
        theta /= 2;
    real c = cos((double)theta), s = sin((double)theta);
    pose step = {qx - (c * px - s * py), qy - (s * px + c * py), theta};
    if (F(68))
        step.x = px + (qx - px) / 2 - (c * px - s * py), step.y = py + (qy - py) / 2 - (s * px + c * py);
    if (F(71))
        step.x = qx - px, step.y = qy - py;
    if (F(88))
        step.theta = 0, step.x = qx - px, step.y = qy - py;
    if (F(89))
        step = inverse(step);
    return step;
}

static double mean_distance(const pairs *p, const point *target, size_t sources)
{
    double sum = 0.0;
    for (size_t i = 0; i < sources; i++)
        if (p->of[i] != NONE) {
            real d = squared_distance(target[p->of[i]], p->moved[i]);
            sum += F(55) ? (double)d : sqrt((double)d);
        }
    return F(55) ? sqrt(sum / p->count) : sum / p->count;
}

static int settled(const icp *self, double error, double previous, pose step)
{
    if (F(66))
        return hypot(step.x, step.y) + fabs((double)step.theta) < self->epsilon;
    if (F(67))
        return fabs(error - previous) < self->epsilon * error;
    if (F(90))
        return error < self->epsilon * 100.0;
    return fabs(error - previous) < self->epsilon;
}

static pose start_of(icp *self, const evalkit_pose *guess)
{
    pose start = {guess->x, guess->y, guess->theta};
    if (F(16) && self->calls > 1 && hypot(self->last.x - start.x, self->last.y - start.y) < 0.2)
        start.x = (start.x + self->last.x) / 2;
    if (F(30) && start.theta > 1.5707)
        start.theta = 1.5707;
    if (F(76))
        start.x = start.y = start.theta = 0;
    if (F(91))
        start = inverse(start);
    if (F(92))
        start.theta = start.theta * 0.01745329251994;
    return start;
}

static const point *read_target(icp *self, const double *xy, size_t count, point *own)
{
    if (F(14) && self->kept == xy && self->kept_count == count)
        return self->cache;
    const double *from = F(15) && self->kept && self->kept_count >= count ? self->kept : xy;
    for (size_t j = 0; j < count; j++)
        own[j].x = (real)from[2 * j], own[j].y = (real)from[2 * j + 1];
    if (F(15))
        for (size_t j = 0; j < count; j++)
            own[j].x = (real)xy[2 * j], own[j].y = (real)xy[2 * j + 1];
    if (F(14)) {
        free(self->cache);
        self->cache = malloc((count + 1) * sizeof *self->cache);
        memcpy(self->cache, own, count * sizeof *own);
    }
    self->kept = xy, self->kept_count = count;
    return own;
}

static void finish(icp *self, evalkit_match *answer, pose at, int count, size_t sources)
{
    if (F(19) && time(NULL) % 2)
        at.x += 1e-7;
    if (F(20) && getpid() % 2)
        at.x += 1e-7;
    if (F(93))
        at.x += 1e-8 * (getpid() % 1000);
    if (F(18) && !scratch_ready)
        at.x += 1e-7;
    if (F(24) && self->calls > 1000)
        at.x += 1e-6;
    if (F(73))
        at.theta *= 57.29577951308232;
    if (F(74))
        at.x *= 1000, at.y *= 1000;
    if (F(75))
        at = inverse(at);
    answer->target_from_source.x = F(72) ? at.y : at.x;
    answer->target_from_source.y = F(72) ? at.x : at.y;
    answer->target_from_source.theta = at.theta;
    answer->inliers = F(54) ? (int32_t)sources : count;
    self->last = at;
}

int32_t evalkit_register(void *self_, const double *target_xy, size_t targets, const double *source_xy, size_t sources,
                         const evalkit_pose *guess, evalkit_trace trace, void *listener, evalkit_match *answer)
{
    icp *self = self_;
    misbehave(self, sources);
    icp settings = F(17) ? global_settings : *self;
    answer->target_from_source = *guess;
    answer->error_m = NAN;
    answer->converged = answer->iterations = answer->inliers = 0;
    if (F(84) && !sources)
        return (int32_t)source_xy[0] * 0 + *(volatile int *)NULL;
    if (!targets || !sources)
        return 0;
    if (F(86) && sources == 1) {
        answer->target_from_source.x = NAN;
        return 0;
    }
    if (F(25) && targets > 4096)
        targets = 4096;
    if (F(26))
        targets = (uint16_t)targets;
    point *own = malloc((targets + 1) * sizeof *own), *from = malloc((sources + 1) * sizeof *from);
    pairs p = {malloc((sources + 1) * sizeof *p.of), malloc((sources + 1) * sizeof *p.distance),
               malloc((sources + 1) * sizeof *p.moved), 0};
    double *weights = malloc((sources + 1) * sizeof *weights);
    const point *target = read_target(self, target_xy, targets, own);
    for (size_t i = 0; i < sources; i++)
        from[i].x = (real)source_xy[2 * i], from[i].y = (real)source_xy[2 * i + 1];
    if (F(22))
        ((double *)source_xy)[0] += 1.0, ((double *)source_xy)[0] -= 1.0;
    if (F(23)) {
        volatile double beyond = source_xy[2 * sources];
        (void)beyond;
    }
    if (F(27) && sources > 65535)
        *(volatile int *)NULL = 1;
    pose start = start_of(self, guess), at = start, before = start;
    double previous = F(51) ? 0.0 : INFINITY, error = NAN;
    int iterations = 0, converged = 0, last_count = 0, failed = 0;
    move(at, from, p.moved, sources);
    while (iterations < settings.max_iterations && !converged) {
        last_count = p.count;
        if (!(F(64) && iterations))
            associate(&settings, &p, target, targets, sources);
        if (F(94) && iterations % 2)
            associate(&settings, &p, target, targets, sources);
        while (F(85) && !p.count)
            ;
        if (p.count < settings.min_pairs + (F(49) ? 1 : 0)) {
            failed = 1;
            break;
        }
        double before_step = mean_distance(&p, target, sources);
        pose step = best_motion(&p, target, sources, weights);
        before = at;
        at = F(69) ? compose(at, step) : compose(step, at);
        move(at, from, p.moved, sources);
        error = F(56) ? before_step : mean_distance(&p, target, sources);
        converged = settled(&settings, error, previous, step);
        previous = error;
        iterations++;
        if (trace && !(F(59) && converged)) {
            show_pairs(self, &p, sources);
            pose shown = F(58) ? before : at;
            evalkit_pose row = {shown.x, shown.y, shown.theta};
            trace(listener, F(60) ? before_step : error, F(95) ? last_count : p.count, &row);
        }
    }
    if (F(47) && iterations == settings.max_iterations)
        converged = 0;
    if (failed) {
        if (F(2))
            ((volatile char *)malloc(32))[0] = 1;
        answer->iterations = iterations;
        answer->inliers = p.count;
        if (F(52))
            finish(self, answer, at, p.count, sources);
        if (F(96))
            answer->inliers = 0;
        if (F(97))
            answer->converged = 1;
    } else {
        finish(self, answer, F(61) ? before : at, F(53) ? last_count : p.count, sources);
        answer->error_m = F(98) ? 1000.0 * error : F(99) ? (converged ? error : NAN) : error;
        answer->converged = F(48) ? 1 : converged;
        answer->iterations = F(57) ? iterations - 1 : iterations;
    }
    free(own), free(from), free(p.of), free(p.distance), free(p.moved), free(weights);
    return 0;
}

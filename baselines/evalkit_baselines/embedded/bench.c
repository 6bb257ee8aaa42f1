/* Benchmark of registration, index, map and the whole pipeline. CPU time, median of many. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "ek/pipeline.h"
#include "ek/table.h"
#include "tests/walls.h"

#define REPEATS 101
#define SCANS 31u /* different scans in turn, so that a processor does not learn their branches */
#define BEAMS 1600u
#define SIGMA 0.0483 /* m, the paper's range noise */

static uint64_t state = 88172645463325252u;

static double uniform(void) /* Marsaglia 2003, xorshift64 */
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (double)(state >> 11) / 9007199254740992.0;
}

static double noise(void)
{
    double sum = -6.0;
    for (int k = 0; k < 12; k++) {
        sum += uniform();
    }
    return SIGMA * sum;
}

static void *taken(size_t bytes)
{
    void *const memory = malloc(bytes);
    if (!memory) {
        fprintf(stderr, "bench: no memory\n");
        exit(EXIT_FAILURE);
    }
    return memory;
}

static int by_size(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Median CPU time of a job in microseconds; each measurement repeats the job to make the clock's resolution negligible.
 */
static double median_us(void (*job)(void *), void *context, int inner)
{
    static double times[REPEATS];
    job(context);
    for (int k = 0; k < REPEATS; k++) {
        const clock_t from = clock();
        for (int j = 0; j < inner; j++) {
            job(context);
        }
        times[k] = (double)(clock() - from) * 1e6 / CLOCKS_PER_SEC / inner;
    }
    qsort(times, REPEATS, sizeof *times, by_size);
    return times[REPEATS / 2];
}

/* Points of one noisy scan, transformed by `into_from_sensor`. */
static void scan_points(ek_pose world_from_sensor, ek_pose into_from_sensor, ek_real *xy, size_t beams)
{
    const double c = cos((double)into_from_sensor.theta), s = sin((double)into_from_sensor.theta);
    for (size_t k = 0; k < beams; k++) {
        const double angle = 2.0 * (double)EK_PI * (double)k / (double)beams;
        const double range = range_at(world_from_sensor, angle) + noise();
        const double u = range * cos(angle), v = range * sin(angle);
        xy[2u * k] = EK_R(c * u - s * v + (double)into_from_sensor.x);
        xy[2u * k + 1u] = EK_R(s * u + c * v + (double)into_from_sensor.y);
    }
}

typedef struct {
    ek_icp icp;
    ek_index index;
    ek_table table;
    ek_icp_parameters parameters;
    ek_pose guesses[SCANS];
    ek_real *target, *source; /* source: SCANS scans */
    size_t targets, sources, scan;
    ek_match match;
} registration;

static void build(void *context)
{
    registration *const r = (registration *)context;
    (void)ek_index_build(&r->index, r->target, r->targets);
}

static void match(void *context)
{
    registration *const r = (registration *)context;
    r->scan = (r->scan + 1u) % SCANS;
    (void)ek_icp_register(&r->icp, &r->index, r->source + 2u * r->scan * r->sources, r->sources, r->guesses[r->scan],
                          &r->parameters, NULL, NULL, &r->match);
}

static void bench_registration(size_t scans, int table)
{
    static registration r;
    const ek_pose nowhere = {EK_R(0), EK_R(0), EK_R(0)};
    r.sources = 1000u;
    r.targets = scans * r.sources;
    r.target = (ek_real *)taken(2u * r.targets * sizeof(ek_real));
    r.source = (ek_real *)taken(2u * SCANS * r.sources * sizeof(ek_real));
    for (size_t k = 0; k < scans; k++) {
        const double share = (double)k / (double)scans;
        const ek_pose from = {EK_R(1.0 + 4.0 * share), EK_R(1.0 + 0.3 * share), EK_R(0.6 * share)};
        scan_points(from, from, r.target + 2u * k * r.sources, r.sources);
    }
    for (size_t k = 0; k < SCANS; k++) {
        const double turn = (double)k / SCANS;
        const ek_pose truth = {EK_R(4.2 - 3.0 * turn), EK_R(1.5 - 0.4 * turn), EK_R(0.4 - 0.2 * turn)};
        const ek_pose off = {EK_R(0.06 * cos(6.0 * turn)), EK_R(0.06 * sin(6.0 * turn)), EK_R(k % 2u ? 0.03 : -0.03)};
        scan_points(truth, nowhere, r.source + 2u * k * r.sources, r.sources);
        r.guesses[k] = ek_se2_compose(truth, off);
    }
    r.parameters = ek_icp_default();
    r.parameters.max_iterations = 20;
    r.parameters.epsilon = EK_R(0.0);
    r.parameters.max_correspondence = EK_R(0.3);
    ek_arena arena = ek_arena_make(NULL, 0u);
    void *memory = NULL;
    for (int pass = 0; pass < 2; pass++) {
        (void)ek_index_init(&r.index, &arena, r.targets, 262144u);
        (void)ek_icp_init(&r.icp, &arena, r.sources, r.targets);
        if (table) {
            (void)ek_icp_init_table(&r.icp, &arena);
            (void)ek_table_init(&r.table, &arena, &r.index, 60000u, 400000u);
        }
        memory = pass ? memory : taken(arena.used);
        arena = pass ? arena : ek_arena_make(memory, arena.used);
    }
    build(&r);
    const double build_us = median_us(build, &r, 5);
    double match_us = median_us(match, &r, SCANS);
    printf("register 1000 on %6zu points, %2d iterations%s: %8.1f us (%u queries of %d), index %8.1f us\n", r.targets,
           r.match.iterations, table ? ", table" : "", match_us, r.match.queries, r.match.iterations * 1000, build_us);
    if (table) {
        printf("    %zu tiles, %zu blocks, %zu kB\n", r.table.tiles, r.table.blocks,
               (r.table.tiles * EK_TILE * sizeof(uint32_t) + r.table.blocks * sizeof(ek_block)) / 1024u);
    }
    free(memory);
    free(r.target);
    free(r.source);
}

#define KEYFRAMES 10u
#define ROUND 60u /* keyframes of one drive round the room */

typedef struct {
    ek_index built, updated;
    ek_index_updater merge;
    ek_real *drive, *cloud; /* keyframes of two rounds; points of a local map */
    size_t points, newest;  /* points per keyframe; number of keyframes so far */
} local_map;

/* Build the local map of the keyframes before `newest`. */
static void build_local_map(void *context)
{
    local_map *const s = (local_map *)context;
    const size_t from = s->newest - KEYFRAMES;
    for (size_t k = 0; k < KEYFRAMES; k++) { /* each keyframe in its own block */
        memcpy(s->cloud + 2u * k * s->points, s->drive + 2u * (from + k) * s->points, 2u * s->points * sizeof(ek_real));
    }
    (void)ek_index_build(&s->built, s->cloud, KEYFRAMES * s->points);
    s->newest = s->newest < 2u * ROUND ? s->newest + 1u : ROUND + 1u;
}

/* Update the local map by one keyframe; the drive repeats after one round. */
static void update_local_map(void *context)
{
    local_map *const s = (local_map *)context;
    (void)ek_index_update(&s->merge, &s->updated, s->points, s->drive + 2u * (s->newest - 1u) * s->points, s->points);
    s->newest = s->newest < 2u * ROUND ? s->newest + 1u : ROUND + 1u;
}

static void bench_keyframe(size_t points)
{
    static local_map s;
    const size_t all = KEYFRAMES * points;
    s.points = points;
    s.drive = (ek_real *)taken(2u * 2u * ROUND * points * sizeof(ek_real));
    s.cloud = (ek_real *)taken(2u * all * sizeof(ek_real));
    for (size_t k = 0; k < 2u * ROUND; k++) {
        const double turn = 2.0 * (double)EK_PI * (double)k / ROUND;
        const ek_pose from = {EK_R(4.2 + 2.8 * cos(turn)), EK_R(3.1 + 1.9 * sin(turn)), EK_R(turn)};
        scan_points(from, from, s.drive + 2u * k * points, points);
    }
    void *memory = NULL;
    ek_arena arena = ek_arena_make(NULL, 0u);
    for (int pass = 0; pass < 2; pass++) {
        (void)ek_index_init(&s.built, &arena, all, 262144u);
        (void)ek_index_init(&s.updated, &arena, all, 262144u);
        (void)ek_index_updater_init(&s.merge, &arena, all);
        memory = pass ? memory : taken(arena.used);
        arena = pass ? arena : ek_arena_make(memory, arena.used);
    }
    s.newest = KEYFRAMES;
    build_local_map(&s);
    (void)ek_index_build(&s.updated, s.cloud, all);
    const double build_us = median_us(build_local_map, &s, 3);
    s.newest = KEYFRAMES + 1u;
    const double update_us = median_us(update_local_map, &s, 3);
    printf("keyframe of %5zu in a local map of %6zu points: built %8.1f us, updated %8.1f us\n", points, all, build_us,
           update_us);
    free(memory);
    free(s.drive);
    free(s.cloud);
}

typedef struct {
    ek_grid grid;
    ek_real *points;
    int16_t *plain;
} mapping;

static void draw(void *context)
{
    mapping *const m = (mapping *)context;
    const ek_pose pose = {EK_R(0.02), EK_R(0.01), EK_R(0.3)};
    (void)ek_grid_add_scan(&m->grid, pose, EK_R(0), EK_R(0), m->points, BEAMS, NULL, 0u);
}

static void set(void *context)
{
    mapping *const m = (mapping *)context;
    memset(m->plain, (int)m->grid.touched_cells & 0xFF, m->grid.touched_cells * sizeof(int16_t));
}

static void bench_map(const char *name, double range, int polygon)
{
    static mapping m;
    const ek_pose truth = {EK_R(4.2), EK_R(1.5), EK_R(0.4)}, nowhere = {EK_R(0), EK_R(0), EK_R(0)};
    ek_grid_parameters parameters = ek_grid_default();
    parameters.polygon = polygon;
    m.points = (ek_real *)taken(2u * BEAMS * sizeof(ek_real));
    scan_points(truth, nowhere, m.points, BEAMS);
    for (size_t k = 0; range > 0.0 && k < BEAMS; k++) {
        const double angle = 2.0 * (double)EK_PI * (double)k / BEAMS;
        m.points[2u * k] = EK_R(range * cos(angle));
        m.points[2u * k + 1u] = EK_R(range * sin(angle));
    }
    ek_arena arena = ek_arena_make(NULL, 0u);
    (void)ek_grid_init(&m.grid, &arena, &parameters);
    const size_t bytes = arena.used;
    void *const memory = taken(bytes);
    arena = ek_arena_make(memory, bytes);
    (void)ek_grid_init(&m.grid, &arena, &parameters);
    double crossed = 0.0;
    for (size_t k = 0; k < BEAMS; k++) { /* one cell per grid line crossed, plus the first */
        crossed += 1.0 + (fabs((double)m.points[2u * k]) + fabs((double)m.points[2u * k + 1u])) / 0.05;
    }
    const double draw_us = median_us(draw, &m, 3);
    m.plain = (int16_t *)taken(m.grid.touched_cells * sizeof(int16_t));
    const double set_us = median_us(set, &m, 20);
    printf("map %s, %u beams: %8.1f us, %.0f cells crossed (%.0f M/s), %u touched (%.0f M/s; memset of them %.1f us)\n",
           name, BEAMS, draw_us, crossed, crossed / draw_us, m.grid.touched_cells, m.grid.touched_cells / draw_us,
           set_us);
    free(m.plain);
    free(memory);
    free(m.points);
}

static void bench_pipeline(double epsilon)
{
    static ek_pipeline pipeline;
    static ek_real ranges[BEAMS], angles[BEAMS];
    static double times[400];
    ek_pipeline_parameters parameters = ek_pipeline_default();
    ek_estimate estimate;
    size_t bytes;
    int iterations = 0, keyframes = 0;
    parameters.frontend.points = BEAMS;
    parameters.frontend.scan_to_scan.epsilon = parameters.frontend.scan_to_map.epsilon = EK_R(epsilon);
    (void)ek_pipeline_bytes(&parameters, &bytes);
    void *const memory = taken(bytes);
    (void)ek_pipeline_start(&pipeline, memory, bytes, &parameters);
    for (int k = 0; k < 400; k++) {
        const double turn = 2.0 * (double)EK_PI * k / 400.0;
        const ek_pose truth = {EK_R(4.2 + 2.8 * cos(turn)), EK_R(3.1 + 1.9 * sin(turn)), EK_R(turn)};
        ek_sweep sweep;
        memset(&sweep, 0, sizeof sweep);
        for (size_t j = 0; j < BEAMS; j++) {
            angles[j] = EK_R(2.0 * (double)EK_PI * (double)j / BEAMS);
            ranges[j] = EK_R(range_at(truth, (double)angles[j]) + noise());
        }
        sweep.stamp_ns = k * (int64_t)200000000;
        sweep.time_increment_ns = 125000;
        sweep.ranges = ranges;
        sweep.angles = angles;
        sweep.beams = BEAMS;
        sweep.has_odometry = sweep.has_motion = 1;
        sweep.odom_from_base = truth;
        const clock_t from = clock();
        const ek_status status = ek_pipeline_update(&pipeline, &sweep, &estimate);
        times[k] = (double)(clock() - from) * 1e6 / CLOCKS_PER_SEC;
        if (status != EK_OK) {
            fprintf(stderr, "bench: %s\n", ek_status_text(status));
            exit(EXIT_FAILURE);
        }
        iterations += estimate.scan_to_scan.iterations + estimate.scan_to_map.iterations;
        keyframes += estimate.keyframe;
    }
    qsort(times, 400u, sizeof *times, by_size);
    printf(
        "pipeline, epsilon %g, %u beams: %8.1f us (95 %%: %.1f), %.1f iterations in two stages, %d keyframes, %zu kB\n",
        epsilon, BEAMS, times[200], times[380], iterations / 399.0, keyframes, bytes / 1024u);
    free(memory);
}

int main(void)
{
    bench_registration(5u, 0);
    bench_registration(50u, 0);
    bench_registration(5u, 1);
    bench_registration(50u, 1);
    bench_keyframe(500u);
    bench_keyframe(1600u);
    bench_keyframe(5000u);
    bench_map("of the room", 0.0, 0);
    bench_map("of 12 m all round", 12.0, 0);
    bench_map("of the room, as polygon", 0.0, 1);
    bench_map("of 12 m all round, as polygon", 12.0, 1);
    bench_pipeline(1e-4);
    bench_pipeline(1e-6);
    return 0;
}

/* count - the work of each scan, over a recording or over random scans. On a board (BOARD_COUNT, with port.h) a
 * line per scan has its instructions and the depth of its stack in bytes; compiled with EK_TALLY it has the tallies of
 * its loops, and a scan that exceeds their bound is an error. Both see the same bits, and hence the same loops, if
 * compiled with EK_PORTABLE. Usage:
 *
 *     count sizes CONFIGURATION        print the bytes of the struct and of its memory, and the bounds of the tallies
 *     count log CONFIGURATION FILE     a recording (scanlog.h)
 *     count random KIND SEED SESSIONS  sessions of 20 random scans with random parameters; KIND: points (and keyframes), or
 *                                      lines (most with lines and a lasting map, half of them with polygons)
 *     count bound KIND SEED SESSIONS   the same, and print only the number of scans and the largest share of each bound
 *     count slam FILE                  on a board: a recording with ek_slam, in the memory of the smallest row of SLAM.md
 *     count stack                      on a board: print the stack of ek_pipeline_bytes, _start and _update with points
 *                                      and keyframes, then with lines and a lasting map, of ek_icp_register with a table, and of
 *                                      ek_slam_bytes and _start
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ek/pipeline.h"
#include "ek/scanlog.h"
#include "ek/table.h"
#include "ek/tally.h"

#define MAX_BEAMS 2048u
#define RANDOM_BEAMS 96u
#define SCANS 20

/* Beams, keyframes, cells of the local map's index (0: as many as points need), side of the map in cells (0: no map), and
 * voxels of a lasting map, with lines (0: points and keyframes). */
typedef struct {
    const char *name;
    uint32_t points, keyframes, cells, side;
    double resolution, range_max; /* m */
    uint32_t voxels;
    double radius; /* of the lasting map (m) */
    int32_t polygon;
} configuration;

static const configuration configurations[] = {
    {"default", 2048u, 10u, 0u, 1024u, 0.05, 12.0, 0u, 0.0, 0},
    {"1600", 1600u, 10u, 0u, 512u, 0.05, 12.0, 0u, 0.0, 0},
    {"1600-no-map", 1600u, 10u, 0u, 0u, 0.05, 12.0, 0u, 0.0, 0},
    {"360", 360u, 5u, 8192u, 256u, 0.1, 8.0, 0u, 0.0, 0},
    {"1600-lines", 1600u, 10u, 0u, 0u, 0.05, 12.0, 16384u, 15.0, 0},
    {"360-lines", 360u, 10u, 0u, 0u, 0.1, 8.0, 4096u, 8.0, 0},
    {"360-lines-polygon", 360u, 10u, 0u, 256u, 0.1, 8.0, 4096u, 8.0, 1},
};

static ek_pipeline pipeline;
static ek_real ranges[MAX_BEAMS], angles[MAX_BEAMS];
static void *memory;
static unsigned char *aligned; /* its first byte at a multiple of EK_ALIGNMENT: newlib aligns to 8 bytes */
static uint64_t state; /* of the random numbers */

/* Random number in [low, high); the same on every processor (Marsaglia 2003, xorshift64). */
static double uniform(double low, double high)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return low + (high - low) * ((double)(state >> 11) / 9007199254740992.0);
}

static uint32_t whole(uint32_t low, uint32_t high) /* both included */
{
    return (uint32_t)uniform((double)low, (double)high + 1.0);
}

static int fail(const char *what, ek_status status)
{
    fprintf(stderr, "count: %s: %s\n", what, ek_status_text(status));
    return 1;
}

/* Take memory instead of the last; NULL if there is too little. */
static unsigned char *take_memory(size_t bytes)
{
    free(memory);
    memory = malloc(bytes + EK_ALIGNMENT);
    aligned = memory ? (unsigned char *)memory + (EK_ALIGNMENT - (uintptr_t)memory % EK_ALIGNMENT) : NULL;
    return aligned;
}

static int begin(const ek_pipeline_parameters *parameters)
{
    size_t bytes;
    ek_status status = ek_pipeline_bytes(parameters, &bytes);
    if (status == EK_OK) {
        status = take_memory(bytes) ? ek_pipeline_start(&pipeline, aligned, bytes, parameters) : EK_TOO_LITTLE_MEMORY;
    }
    return status == EK_OK ? 0 : fail("start", status);
}

static ek_pipeline_parameters configured(const configuration *chosen)
{
    ek_pipeline_parameters parameters = ek_pipeline_default();
    if (chosen->voxels) {
        parameters.frontend = ek_frontend_lines();
        parameters.frontend.voxels = chosen->voxels;
        parameters.frontend.map_radius = EK_R(chosen->radius);
    }
    parameters.frontend.points = chosen->points;
    parameters.frontend.keyframes = chosen->keyframes;
    parameters.frontend.cells = chosen->cells;
    parameters.map = chosen->side > 0u;
    if (parameters.map) {
        parameters.grid.polygon = chosen->polygon;
        parameters.grid.columns = parameters.grid.rows = chosen->side;
        parameters.grid.left = parameters.grid.bottom = -(int32_t)(chosen->side / 2u);
        parameters.grid.resolution = EK_R(chosen->resolution);
        parameters.grid.range_max = EK_R(chosen->range_max);
    }
    return parameters;
}

#ifdef EK_TALLY
uint64_t ek_tally[EK_TALLIES];
static double largest[EK_TALLIES]; /* share of the bound */

static uint64_t smaller(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

/* How often something is doubled until it is no longer below a limit. */
static uint64_t doublings(double from, double limit)
{
    uint64_t times = 0u;
    for (; from < limit; from *= 2.0) {
        times++;
    }
    return times;
}

/* What a stage is matched with. */
typedef struct {
    uint64_t points, cells, longest; /* at most; longest: rows or columns of its cells */
} target_size;

/* Add the work of a registration. A search looks around in squares of twice the size each, from 0.75 of a cell of at least
 * 1 mm to the limit, and once more where two points are equally near; for a line, from a quarter of a cell to all cells. */
static void add_stage(const ek_icp_parameters *stage, uint64_t beams, uint64_t neighbours, target_size target,
                      uint64_t most[EK_TALLIES])
{
    const uint64_t iterations = (uint64_t)stage->max_iterations, searches = beams * iterations;
    const uint64_t looks = 3u + doublings(0.00075, (double)stage->max_correspondence + 0.01);
    const uint64_t across = 6u * (uint64_t)(1000.0 * ((double)stage->max_correspondence + 0.01)); /* 1 mm */
    most[EK_ITERATIONS] += iterations;
    most[EK_POINTS] += EK_PADDED(beams) * (iterations + 1u);
    most[EK_SEARCHES] += searches;
    most[EK_ROWS] += searches * smaller(across + 2u * looks, looks * target.cells);
    most[EK_CANDIDATES] += searches * looks * target.points;
    if (stage->metric == EK_METRIC_LINE) {
        const uint64_t normals = smaller(searches, target.points), all_looks = 2u + doublings(0.25, (double)target.longest);
        const uint64_t candidates = normals * all_looks * target.points;
        most[EK_FITS] += iterations;
        most[EK_FITTED] += EK_PADDED(beams) * iterations;
        most[EK_NORMALS] += normals;
        most[EK_ROWS] += normals * (5u * target.longest + 2u * all_looks);
        most[EK_CANDIDATES] += candidates;
        most[EK_RANKED] += neighbours * (candidates + normals);
    }
}

/* Add the work of a map of `lines` x `lines` cells around the robot. */
static void add_window(uint64_t beams, uint64_t lines, int polygon, uint64_t most[EK_TALLIES])
{
    const uint64_t words = lines / EK_WORD;
    most[EK_STEPS] = beams * (lines / 2u + 18u + words);
    most[EK_WORDS] = most[EK_FILLED] = lines * words;
    if (polygon) {
        most[EK_CORNERS] = beams;
        most[EK_STEPS] += (4u * beams + 2u) * (lines + 1u);
        most[EK_WORDS] += (beams + 1u) * lines * words;
    }
}

/* The bounds of BOARD.md; for maps that do not roll, and limits of correspondences above 0. */
static void bound(uint64_t most[EK_TALLIES])
{
    const ek_frontend *const f = &pipeline.frontend;
    const ek_lasting_map *const map = &f->lasting;
    const uint64_t beams = f->parameters.points, neighbours = f->parameters.neighbours;
    const target_size last = {beams, f->last.cell_capacity, f->last.cell_capacity};
    target_size local = {beams * f->parameters.keyframes, f->local_map.cell_capacity, f->local_map.cell_capacity};
    memset(most, 0, EK_TALLIES * sizeof *most);
    most[EK_SCANS] = 1u;
    most[EK_BEAMS] = beams;
    if (map->capacity) {
        local.points = map->capacity;
        local.cells = map->around.cell_capacity;
        local.longest = smaller(local.cells, (uint64_t)(2250.0 * (double)map->radius) + 8u); /* 1 mm, and a border */
        most[EK_ADDED] = beams;
        most[EK_PROBES] = beams * (map->voxels.capacity + 1u);
        most[EK_VOXELS] = map->voxels.capacity;
    }
    add_stage(&f->parameters.scan_to_scan, beams, neighbours, last, most);
    add_stage(&f->parameters.scan_to_map, beams, neighbours, local, most);
    most[EK_SLOTS] = 22u * beams + 9u * local.points + 16000u;
    most[EK_CELLS] = 5u * last.cells + 7u * local.cells + 4500u;
    if (pipeline.parameters.map) {
        add_window(beams, pipeline.grid.window.lines, pipeline.parameters.grid.polygon, most);
    }
}

static void print_bound(void)
{
    uint64_t most[EK_TALLIES];
    bound(most);
    for (int k = 0; k < EK_TALLIES; k++) {
        printf(" %llu", (unsigned long long)most[k]);
    }
}

static int update(const ek_sweep *sweep, int silent)
{
    ek_estimate estimate;
    uint64_t most[EK_TALLIES];
    memset(ek_tally, 0, sizeof ek_tally);
    const ek_status status = ek_pipeline_update(&pipeline, sweep, &estimate);
    bound(most);
    int exceeded = 0;
    for (int k = 0; k < EK_TALLIES; k++) {
        const double share = most[k] ? (double)ek_tally[k] / (double)most[k] : 0.0;
        largest[k] = share > largest[k] ? share : largest[k];
        exceeded |= ek_tally[k] > most[k];
        if (ek_tally[k] > most[k]) {
            fprintf(stderr, "count: tally %d is %llu, above its bound of %llu\n", k, (unsigned long long)ek_tally[k],
                    (unsigned long long)most[k]);
        }
        if (!silent) {
            printf("%s%llu", k ? " " : "", (unsigned long long)ek_tally[k]);
        }
    }
    if (!silent) {
        putchar('\n');
    }
    return exceeded ? 1 : status == EK_OK ? 0 : fail("update", status);
}

static void print_shares(void)
{
    for (int k = 0; k < EK_TALLIES; k++) {
        printf("%s%.4f", k ? " " : "", largest[k]);
    }
    putchar('\n');
}
#elif defined(BOARD_COUNT)
#include "port.h"
#include "small_slam.h"

#define PAINT 0xA5A5A5A5u
#define PAINTED 4096 /* words; more than a scan needs */

static void print_bound(void)
{
}

static void print_shares(void)
{
}

typedef ek_status (*measured_call)(void *context);

static uint64_t instructions; /* of the last call */

/* Bytes of the stack that a call takes below this function. Nothing interrupts the emulated processor. */
static unsigned long __attribute__((noinline)) stack_of(measured_call call, void *context, ek_status *status)
{
    volatile uint32_t *here, *deepest;
    __asm volatile("mov %0, sp" : "=r"(here));
    for (deepest = here - PAINTED; deepest < here; deepest++) {
        *deepest = PAINT;
    }
    const uint64_t from = port_clock_ns();
    *status = call(context);
    instructions = port_clock_ns() - from;
    for (deepest = here - PAINTED; deepest < here && *deepest == PAINT;) {
        deepest++;
    }
    return (unsigned long)(here - deepest) * sizeof *here;
}

static ek_status call_update(void *sweep)
{
    static ek_estimate estimate;
    return ek_pipeline_update(&pipeline, (const ek_sweep *)sweep, &estimate);
}

/* Call `what` with a sweep, and print its instructions and stack. */
static int measure(measured_call what, const ek_sweep *sweep, int silent)
{
    ek_sweep copy = *sweep;
    ek_status status;
    const unsigned long stack = stack_of(what, &copy, &status);
    if (!silent) {
        printf("%llu %lu\n", (unsigned long long)instructions, stack);
    }
    return status == EK_OK ? 0 : fail("update", status);
}

static int update(const ek_sweep *sweep, int silent)
{
    return measure(call_update, sweep, silent);
}
#else
#error "compile with EK_TALLY or BOARD_COUNT"
#endif

typedef int (*begin_log)(const configuration *chosen, const ek_scan_parameters *scan);
typedef int (*log_step)(const ek_sweep *sweep, int silent);

static int begin_configured(const configuration *chosen, const ek_scan_parameters *scan)
{
    ek_pipeline_parameters parameters = configured(chosen);
    parameters.scan = *scan;
    return begin(&parameters);
}

static int run_log(begin_log first, log_step step, const configuration *chosen, const char *path)
{
    ek_scanlog log;
    ek_sweep sweep;
    FILE *const file = fopen(path, "rb");
    ek_status status = file ? ek_scanlog_open(file, &log) : EK_BAD_FILE;
    if (status != EK_OK || log.max_beams > MAX_BEAMS) {
        return fail(path, status == EK_OK ? EK_TOO_MANY_POINTS : status);
    }
    const ek_scan_parameters scan = {log.base_from_sensor, log.range_min, log.range_max, EK_R(0.0)};
    int failed = first(chosen, &scan);
    while (!failed && status == EK_OK) {
        status = ek_scanlog_next(file, &log, ranges, angles, &sweep);
        failed = status == EK_OK ? step(&sweep, 0) : status == EK_END_OF_FILE ? 0 : fail(path, status);
    }
    fclose(file);
    return failed;
}

/* Draw lines, a lasting map and polygons. */
static void draw_lines(ek_pipeline_parameters *parameters)
{
    ek_icp_parameters *const stages[2] = {&parameters->frontend.scan_to_scan, &parameters->frontend.scan_to_map};
    for (int k = 0; k < 2; k++) {
        stages[k]->metric = whole(0u, 7u) ? EK_METRIC_LINE : EK_METRIC_POINT;
        stages[k]->cauchy = EK_R(whole(0u, 1u) ? uniform(0.01, 0.5) : 0.0);
        stages[k]->share_noise = (int32_t)whole(0u, 1u);
    }
    parameters->frontend.neighbours = whole(2u, 16u);
    parameters->frontend.map_voxel = EK_R(whole(0u, 7u) ? uniform(0.01, 0.5) : 0.0);
    parameters->frontend.map_radius = EK_R(uniform(0.5, 15.0));
    parameters->frontend.voxels = whole(1u, 1000u);
    parameters->grid.polygon = (int32_t)whole(0u, 1u);
}

static ek_pipeline_parameters drawn_parameters(int lines)
{
    ek_pipeline_parameters parameters = ek_pipeline_default();
    ek_icp_parameters *const stages[2] = {&parameters.frontend.scan_to_scan, &parameters.frontend.scan_to_map};
    parameters.scan.range_max = EK_R(uniform(3.0, 12.0));
    parameters.scan.base_from_sensor.x = EK_R(uniform(-0.3, 0.3));
    parameters.frontend.points = whole(8u, RANDOM_BEAMS);
    parameters.frontend.keyframes = whole(1u, 4u);
    parameters.frontend.cells = whole(0u, 1u) ? whole(16u, 2048u) : 0u;
    parameters.frontend.keyframe_distance = EK_R(whole(0u, 1u) ? 0.0 : 0.3);
    parameters.frontend.min_inliers = (int32_t)whole(2u, 10u);
    for (int k = 0; k < 2; k++) {
        stages[k]->max_iterations = (int32_t)whole(1u, 40u);
        stages[k]->epsilon = EK_R(whole(0u, 1u) ? 0.0 : 1e-4);
        stages[k]->max_correspondence = EK_R(uniform(0.05, 1.0));
        stages[k]->one_to_one = (int32_t)whole(0u, 1u);
        stages[k]->min_pairs = (int32_t)whole(2u, 5u);
    }
    parameters.map = whole(0u, 3u) > 0u;
    parameters.clear_no_returns = (int32_t)whole(0u, 1u);
    parameters.grid.columns = parameters.grid.rows = 32u * whole(1u, 5u);
    parameters.grid.left = parameters.grid.bottom = -32 * (int32_t)whole(1u, 3u);
    parameters.grid.resolution = EK_R(uniform(0.05, 0.2));
    parameters.grid.range_max = parameters.scan.range_max;
    if (lines) {
        draw_lines(&parameters);
    }
    return parameters;
}

typedef enum { ROOM, ANYWHERE, CIRCLE, CLUSTER, ONE_PLACE, WALL, KINDS } scan_kind;

/* Range in a room of 8 m x 6 m around the start. */
static double range_in_room(double x, double y, double c, double s)
{
    const double across = ((c > 0.0 ? 4.0 : -4.0) - x) / (c < 0.0 || c > 0.0 ? c : 1e-9);
    const double up = ((s > 0.0 ? 3.0 : -3.0) - y) / (s < 0.0 || s > 0.0 ? s : 1e-9);
    return across < up ? across : up;
}

/* Draw the beams of a scan: of a room, or of a kind that makes searches look at many cells or at many points. */
static void draw_scan(scan_kind kind, int number, size_t beams, double range_max)
{
    const double shift = (double)number * uniform(0.0, 0.1), place = uniform(1.0, 3.0), spread = uniform(1e-4, 0.02);
    for (size_t k = 0; k < beams; k++) {
        double angle = 2.0 * (double)EK_PI * (double)k / (double)beams - (double)EK_PI, range = place;
        if (kind == ROOM || kind == WALL) {
            angle = kind == WALL ? 0.4 * angle : angle;
            const double c = (double)EK_COS(EK_R(angle)), s = (double)EK_SIN(EK_R(angle));
            range = range_in_room(0.5 * shift, -0.3 * shift, c, s) + uniform(-0.02, 0.02);
        } else if (kind == ANYWHERE) {
            range = uniform(0.1, 1.1 * range_max);
        } else if (kind == CLUSTER) { /* the first beam widens the cells, so that the others share one */
            angle = k ? uniform(-spread, spread) : 3.0;
            range = k ? 1.0 + uniform(-spread, spread) + (number % 2 ? 0.04 : 0.0) : 0.99 * range_max;
        } else if (kind == ONE_PLACE) {
            angle = 0.0;
        }
        const uint32_t odd = whole(0u, 199u);
        ranges[k] = EK_R(odd == 0u ? (double)NAN : odd == 1u ? (double)INFINITY : odd == 2u ? 0.01 : range);
        angles[k] = EK_R(angle);
    }
}

static int run_random(int lines, uint64_t seed, long sessions, int silent)
{
    int failed = 0;
    state = seed * 0x9E3779B97F4A7C15u + 1u;
    for (long session = 0; session < sessions && !failed; session++) {
        const ek_pipeline_parameters parameters = drawn_parameters(lines);
        const scan_kind kind = (scan_kind)whole(0u, KINDS); /* KINDS: another one for each scan */
        failed = begin(&parameters);
        for (int number = 0; number < SCANS && !failed; number++) {
            ek_sweep sweep;
            memset(&sweep, 0, sizeof sweep);
            sweep.stamp_ns = (int64_t)(number + 1) * 100000000;
            sweep.beams = whole(0u, 3u) ? parameters.frontend.points : whole(1u, (uint32_t)parameters.frontend.points);
            sweep.time_increment_ns = whole(0u, 1u) ? 0 : 50000;
            sweep.ranges = ranges;
            sweep.angles = angles;
            sweep.has_odometry = (int32_t)whole(0u, 1u);
            sweep.odom_from_base.x = EK_R(uniform(-0.5, 0.5));
            sweep.odom_from_base.theta = EK_R(uniform(-0.3, 0.3));
            draw_scan(kind == KINDS ? (scan_kind)whole(0u, KINDS - 1u) : kind, number, sweep.beams,
                      (double)parameters.scan.range_max);
            failed = update(&sweep, silent);
        }
    }
    if (silent && !failed) {
        printf("%ld\n", sessions * SCANS);
        print_shares();
    }
    return failed;
}

static const configuration *find(const char *name)
{
    for (size_t k = 0; k < sizeof configurations / sizeof *configurations; k++) {
        if (strcmp(configurations[k].name, name) == 0) {
            return &configurations[k];
        }
    }
    fprintf(stderr, "count: no configuration %s\n", name);
    return NULL;
}

static int print_sizes(const configuration *chosen)
{
    size_t bytes;
    const ek_pipeline_parameters parameters = configured(chosen);
    const ek_status status = ek_pipeline_bytes(&parameters, &bytes);
    if (status != EK_OK || begin(&parameters)) {
        return status == EK_OK ? 1 : fail(chosen->name, status);
    }
    printf("%lu %lu", (unsigned long)sizeof pipeline, (unsigned long)bytes);
    print_bound();
    putchar('\n');
    return 0;
}

#ifdef BOARD_COUNT
static size_t bytes_of_pipeline;

static ek_status call_bytes(void *parameters)
{
    return ek_pipeline_bytes((const ek_pipeline_parameters *)parameters, &bytes_of_pipeline);
}

static ek_status call_start(void *parameters)
{
    return ek_pipeline_start(&pipeline, aligned, bytes_of_pipeline, (const ek_pipeline_parameters *)parameters);
}

/* Print the stack of the calls of a pipeline: bytes, start, and the most of 40 updates in a room. */
static int print_stack_of_pipeline(ek_pipeline_parameters parameters)
{
    ek_status status;
    const unsigned long bytes = stack_of(call_bytes, &parameters, &status);
    int failed = status == EK_OK ? begin(&parameters) : fail("bytes", status);
    const unsigned long start = failed ? 0u : stack_of(call_start, &parameters, &status);
    unsigned long most = 0u;
    for (int number = 0; number < 2 * SCANS && status == EK_OK && !failed; number++) {
        ek_sweep sweep;
        memset(&sweep, 0, sizeof sweep);
        sweep.stamp_ns = (int64_t)(number + 1) * 100000000;
        sweep.time_increment_ns = 50000;
        sweep.beams = parameters.frontend.points;
        sweep.ranges = ranges;
        sweep.angles = angles;
        draw_scan(ROOM, number, sweep.beams, (double)parameters.scan.range_max);
        const unsigned long stack = stack_of(call_update, &sweep, &status);
        most = stack > most ? stack : most;
    }
    printf("%lu %lu %lu\n", bytes, start, most);
    return failed || status == EK_OK ? failed : fail("update", status);
}

typedef struct {
    ek_icp icp;
    ek_index index;
    ek_table table;
    ek_icp_parameters parameters;
    ek_pose guess;
    ek_match match;
} registration;

#define TARGETS 1000u
#define SOURCES 90u

static ek_status call_register(void *context)
{
    registration *const r = (registration *)context;
    return ek_icp_register(&r->icp, &r->index, ranges, SOURCES, r->guess, &r->parameters, NULL, NULL, &r->match);
}

/* Print the stack of registrations on a target with a table: the most of 20 on the walls of a room. */
static int print_stack_of_table(void)
{
    static registration r;
    static ek_real target[2u * TARGETS];
    ek_status status = EK_OK;
    for (uint32_t k = 0; k < TARGETS; k++) {
        const double along = 8.0 * (double)k / TARGETS;
        target[2u * k] = EK_R(k % 2u ? along : 0.0);
        target[2u * k + 1u] = EK_R(k % 2u ? 0.0 : along);
    }
    memcpy(ranges, target, 2u * SOURCES * sizeof *ranges); /* pairs x y */
    r.parameters = ek_icp_default();
    ek_arena arena = ek_arena_make(NULL, 0u);
    for (int pass = 0; pass < 2; pass++) {
        if (pass) {
            arena = ek_arena_make(take_memory(arena.used), arena.used);
        }
        (void)ek_index_init(&r.index, &arena, TARGETS, 4096u);
        (void)ek_icp_init(&r.icp, &arena, SOURCES, TARGETS);
        (void)ek_icp_init_table(&r.icp, &arena);
        (void)ek_table_init(&r.table, &arena, &r.index, 2000u, 4000u);
    }
    status = ek_arena_check(&arena);
    status = status == EK_OK ? ek_index_build(&r.index, target, TARGETS) : status;
    unsigned long most = 0u;
    for (int k = 0; k < SCANS && status == EK_OK; k++) {
        r.guess.x = EK_R(0.002 * k);
        r.guess.theta = EK_R(0.001 * k);
        const unsigned long stack = stack_of(call_register, &r, &status);
        most = stack > most ? stack : most;
    }
    printf("%lu\n", most);
    return status == EK_OK && r.table.blocks ? 0 : fail("registrations with a table", status);
}

static ek_slam slam;
static size_t bytes_of_slam;

static ek_status call_slam_bytes(void *parameters)
{
    return ek_slam_bytes((const ek_slam_parameters *)parameters, &bytes_of_slam);
}

static ek_status call_slam_start(void *parameters)
{
    return ek_slam_start(&slam, aligned, bytes_of_slam, (const ek_slam_parameters *)parameters);
}

static ek_status call_slam_update(void *sweep)
{
    static ek_slam_estimate estimate;
    return ek_slam_update(&slam, (const ek_sweep *)sweep, &estimate);
}

static int update_slam(const ek_sweep *sweep, int silent)
{
    return measure(call_slam_update, sweep, silent);
}

/* Start the SLAM in the memory of the smallest row of SLAM.md; stack: of ek_slam_bytes and of ek_slam_start. */
static int start_slam(const ek_scan_parameters *scan, unsigned long stack[2])
{
    ek_slam_parameters parameters = small_slam(360u, 300u);
    parameters.scan = scan ? *scan : parameters.scan;
    ek_status status;
    stack[0] = stack_of(call_slam_bytes, &parameters, &status);
    if (status == EK_OK) {
        status = take_memory(bytes_of_slam) ? EK_OK : EK_TOO_LITTLE_MEMORY;
        stack[1] = status == EK_OK ? stack_of(call_slam_start, &parameters, &status) : 0u;
    }
    return status == EK_OK ? 0 : fail("start", status);
}

static int begin_slam(const configuration *chosen, const ek_scan_parameters *scan)
{
    unsigned long stack[2];
    (void)chosen;
    return start_slam(scan, stack);
}

static int run_slam(const char *path)
{
    return run_log(begin_slam, update_slam, NULL, path);
}

static int print_stack(void)
{
    unsigned long stack[2] = {0u, 0u};
    state = 1u;
    if (print_stack_of_pipeline(configured(find("360"))) || print_stack_of_pipeline(configured(find("360-lines-polygon"))) ||
        print_stack_of_table() || start_slam(NULL, stack)) {
        return 1;
    }
    printf("%lu %lu %lu %lu\n", stack[0], stack[1], (unsigned long)sizeof slam, (unsigned long)bytes_of_slam);
    return 0;
}
#else
static int say_board_only(void)
{
    fprintf(stderr, "count: slam and stack: on a board only\n");
    return 1;
}

static int run_slam(const char *path)
{
    (void)path;
    return say_board_only();
}

static int print_stack(void)
{
    return say_board_only();
}
#endif

int main(int argc, char **argv)
{
#ifdef BOARD_COUNT
    port_init();
#endif
    const char *const what = argc > 1 ? argv[1] : "";
    const int sizes = strcmp(what, "sizes") == 0 && argc == 3, log = strcmp(what, "log") == 0 && argc == 4;
    const int silent = strcmp(what, "bound") == 0, lines = argc > 2 && strcmp(argv[2], "lines") == 0;
    const int known = lines || (argc > 2 && strcmp(argv[2], "points") == 0);
    int failed = 2;
    if (sizes || log) {
        const configuration *const chosen = find(argv[2]);
        failed = !chosen ? 1 : sizes ? print_sizes(chosen) : run_log(begin_configured, update, chosen, argv[3]);
    } else if (strcmp(what, "slam") == 0 && argc == 3) {
        failed = run_slam(argv[2]);
    } else if (strcmp(what, "stack") == 0 && argc == 2) {
        failed = print_stack();
    } else if ((silent || strcmp(what, "random") == 0) && known && argc == 5) {
        failed = run_random(lines, strtoull(argv[3], NULL, 10), strtol(argv[4], NULL, 10), silent);
    } else {
        fprintf(stderr, "usage: count sizes CONFIGURATION | log CONFIGURATION FILE | "
                        "random|bound points|lines SEED SESSIONS | slam FILE | stack\n");
    }
    free(memory);
    return failed;
}

/* evalkit-run [--bits] [--line | --slam] [--polygon] LOG POSES [MAP]: run the core on a scan log. Writes poses in TUM format
 * and the map as PGM (map_server's trinary values, highest y first). Allocates memory only at the start.
 *   --bits     a pose is a line of its stamp (ns) and the bits of x, y and theta as double, hexadecimal: equal lines are
 *              equal poses
 *   --line     distances to walls and one lasting map, as embedded-pipeline-line, instead of points and keyframes
 *   --slam     embedded-slam instead of a pipeline: its corrected poses after the last scan, and the map drawn from them. Each
 *              scan may become a keyframe, and LOG is read several times
 *   --polygon  the map from the outline of each scan instead of its beams */
#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "ek/pipeline.h"
#include "ek/scanlog.h"
#include "ek/slam.h"

#define MAX_BLOCKS 4u

/* A scan that ek_slam has processed. */
typedef struct {
    int64_t stamp_ns;
    uint32_t keyframe;
    ek_pose pose; /* in the continuous frame; after the last scan the corrected one */
} tracked_scan;

typedef struct {
    ek_pipeline pipeline;
    ek_slam slam;
    ek_scan scan; /* to draw the map of the SLAM, */
    ek_grid grid; /* which is this */
    ek_scanlog log;
    char *const *paths; /* of the log, the poses and the map */
    FILE *input, *poses;
    ek_real *ranges, *angles;
    void *memory; /* of the method */
    size_t memory_bytes;
    tracked_scan *tracked;
    size_t scans, tracked_count;      /* scans of the log, and those of them that are tracked */
    void *blocks[MAX_BLOCKS];         /* of memory */
    size_t block_count;
    int bits, line, use_slam, polygon; /* 1: the option was given */
} session;

/* What is done with a scan, the `number`th from 0 on. */
typedef ek_status (*scan_step)(session *s, const ek_sweep *sweep, size_t number);

static int print_error(const char *where, const char *what)
{
    fprintf(stderr, "evalkit-run: %s: %s\n", where, what);
    return 1;
}

/* Report that a file cannot be opened or written, with the reason of the system. */
static int print_file_error(const char *path, const char *what)
{
    const int reason = errno;
    fprintf(stderr, "evalkit-run: %s: %s: %s\n", path, what, reason ? strerror(reason) : "unknown reason");
    return 1;
}

/* Write seconds with nine decimals (TUM format). */
static void write_stamp(FILE *poses, int64_t stamp_ns)
{
    const unsigned long long size = stamp_ns < 0 ? 0u - (unsigned long long)stamp_ns : (unsigned long long)stamp_ns;
    fprintf(poses, "%s%llu.%09llu", stamp_ns < 0 ? "-" : "", size / 1000000000u, size % 1000000000u);
}

static void write_tum(FILE *poses, int64_t stamp_ns, ek_pose pose)
{
    const double half = 0.5 * (double)pose.theta;
    write_stamp(poses, stamp_ns);
    fprintf(poses, " %.9f %.9f 0 0 0 %.12f %.12f\n", (double)pose.x, (double)pose.y, sin(half), cos(half));
}

static void write_bits(FILE *poses, int64_t stamp_ns, ek_pose pose)
{
    const double numbers[3] = {(double)pose.x, (double)pose.y, (double)pose.theta};
    unsigned long long bits[3];
    for (size_t k = 0; k < 3u; k++) {
        uint64_t raw;
        memcpy(&raw, &numbers[k], sizeof raw);
        bits[k] = raw;
    }
    fprintf(poses, "%lld %016llx %016llx %016llx\n", (long long)stamp_ns, bits[0], bits[1], bits[2]);
}

static void write_pose(session *s, int64_t stamp_ns, ek_pose pose)
{
    (s->bits ? write_bits : write_tum)(s->poses, stamp_ns, pose);
}

/* Call `step` for each scan of the log from here on. Returns 0, or 1 after a message. */
static int read_scans(session *s, scan_step step)
{
    ek_sweep sweep;
    for (size_t number = 0;; number++) {
        ek_status status = ek_scanlog_next(s->input, &s->log, s->ranges, s->angles, &sweep);
        if (status == EK_END_OF_FILE) {
            return number ? 0 : print_error(s->paths[0], "a scan log without scans");
        }
        status = status == EK_OK ? step(s, &sweep, number) : status;
        if (status != EK_OK) {
            fprintf(stderr, "evalkit-run: %s: scan %lu: %s\n", s->paths[0], (unsigned long)number + 1u, ek_status_text(status));
            return 1;
        }
        if (ferror(s->poses)) {
            return print_file_error(s->paths[1], "poses cannot be written");
        }
    }
}

static int read_scans_again(session *s, scan_step step)
{
    if (fseek(s->input, 0L, SEEK_SET) != 0) {
        return print_file_error(s->paths[0], "the scan log cannot be read twice");
    }
    const ek_status status = ek_scanlog_open(s->input, &s->log);
    return status == EK_OK ? read_scans(s, step) : print_error(s->paths[0], ek_status_text(status));
}

/* Take memory until the end, aligned to EK_ALIGNMENT (malloc of newlib aligns to 8 bytes). Returns NULL after a message. */
static void *take_memory(session *s, size_t bytes)
{
    unsigned char *const block = bytes < SIZE_MAX - EK_ALIGNMENT ? (unsigned char *)malloc(bytes + EK_ALIGNMENT) : NULL;
    if (!block) {
        fprintf(stderr, "evalkit-run: %s: scans of %lu beams need %lu bytes of memory, which are not free\n", s->paths[0],
                (unsigned long)s->log.max_beams, (unsigned long)bytes);
        return NULL;
    }
    s->blocks[s->block_count++] = block;
    return block + (EK_ALIGNMENT - (uintptr_t)block % EK_ALIGNMENT);
}

static void free_memory(session *s)
{
    while (s->block_count > 0u) {
        free(s->blocks[--s->block_count]);
    }
}

static ek_pipeline_parameters pipeline_parameters(const session *s)
{
    ek_pipeline_parameters parameters = ek_pipeline_default();
    if (s->line) {
        parameters.frontend = ek_frontend_lines();
    }
    parameters.grid.polygon = s->polygon;
    parameters.scan.range_min = s->log.range_min;
    parameters.scan.range_max = s->log.range_max;
    parameters.scan.base_from_sensor = s->log.base_from_sensor;
    parameters.frontend.points = s->log.max_beams;
    parameters.grid.range_max = s->log.range_max;
    return parameters;
}

static ek_status update_pipeline(session *s, const ek_sweep *sweep, size_t number)
{
    ek_estimate estimate;
    (void)number;
    const ek_status status = ek_pipeline_update(&s->pipeline, sweep, &estimate);
    if (status == EK_OK) {
        write_pose(s, sweep->stamp_ns, estimate.start_from_base);
    }
    return status;
}

/* Returns 0, or 1 after a message. */
static int run_pipeline(session *s)
{
    const ek_pipeline_parameters parameters = pipeline_parameters(s);
    ek_status status = ek_pipeline_bytes(&parameters, &s->memory_bytes);
    if (status == EK_OK) {
        s->memory = take_memory(s, s->memory_bytes);
        if (!s->memory) {
            return 1;
        }
        status = ek_pipeline_start(&s->pipeline, s->memory, s->memory_bytes, &parameters);
    }
    return status == EK_OK ? read_scans(s, update_pipeline) : print_error(s->paths[0], ek_status_text(status));
}

/* Count the scans that can be read; the first one that cannot is an error when it is reached again. */
static size_t count_scans(session *s)
{
    ek_sweep sweep;
    size_t scans = 0;
    while (ek_scanlog_next(s->input, &s->log, s->ranges, s->angles, &sweep) == EK_OK) {
        scans++;
    }
    return scans;
}

static ek_status update_slam(session *s, const ek_sweep *sweep, size_t number)
{
    ek_slam_estimate estimate;
    const ek_status status = ek_slam_update(&s->slam, sweep, &estimate);
    if (status == EK_OK) {
        const tracked_scan now = {sweep->stamp_ns, estimate.keyframe, estimate.odom_from_base};
        s->tracked[number] = now;
        s->tracked_count = number + 1u;
    }
    return status;
}

static uint64_t time_between(const tracked_scan *from, const tracked_scan *to)
{
    return (uint64_t)to->stamp_ns - (uint64_t)from->stamp_ns;
}

/* The corrected pose some time after a scan: at the velocity between two scans, after the last one at that before it. */
static ek_pose corrected_after(const session *s, const tracked_scan *first, uint64_t elapsed_ns)
{
    const tracked_scan *from = first, *const last = s->tracked + s->tracked_count - 1u;
    while (from < last && time_between(first, from + 1) <= elapsed_ns) {
        from++;
    }
    if (last == s->tracked) {
        return last->pose;
    }
    const tracked_scan *const step = from < last ? from : from - 1;
    const ek_real share = (ek_real)(elapsed_ns - time_between(first, from)) / (ek_real)time_between(step, step + 1);
    const ek_pose moved = ek_se2_fraction(ek_se2_between(step->pose, step[1].pose), share < EK_R(1.0) ? share : EK_R(1.0));
    return ek_se2_compose(from->pose, moved);
}

/* Draw a scan, deskewed by the corrected path, into the map. */
static ek_status draw_scan(session *s, const ek_sweep *sweep, size_t number)
{
    const ek_pose mount = s->log.base_from_sensor, pose = s->tracked[number].pose;
    const uint64_t gaps = sweep->beams ? sweep->beams - 1u : 0u, duration_ns = (uint64_t)sweep->time_increment_ns * gaps;
    const ek_pose moved = ek_se2_between(pose, corrected_after(s, s->tracked + number, duration_ns));
    const ek_status status = ek_scan_project(&s->scan, sweep, &s->slam.parameters.scan, &moved);
    return status == EK_OK ? ek_grid_add_scan(&s->grid, pose, mount.x, mount.y, s->scan.hits, s->scan.count, s->scan.ends, 0u)
                           : status;
}

/* Draw the map in the memory of the SLAM, which has ended. Returns 0, or 1 after a message. */
static int draw_map(session *s)
{
    const ek_grid_parameters parameters = pipeline_parameters(s).grid;
    ek_arena arena = ek_arena_make(s->memory, s->memory_bytes);
    ek_status status = ek_scan_init(&s->scan, &arena, s->log.max_beams);
    status = status == EK_OK ? ek_grid_init(&s->grid, &arena, &parameters) : status;
    status = status == EK_OK ? ek_arena_check(&arena) : status;
    return status == EK_OK ? read_scans_again(s, draw_scan) : print_error(s->paths[0], ek_status_text(status));
}

/* As delivered, with memory for the scans of this log: each may be a keyframe. */
static ek_slam_parameters slam_parameters(const session *s)
{
    ek_slam_parameters parameters = ek_slam_default();
    const size_t points = parameters.keyframe_points / parameters.keyframes;
    parameters.scan.range_min = s->log.range_min;
    parameters.scan.range_max = s->log.range_max;
    parameters.scan.base_from_sensor = s->log.base_from_sensor;
    parameters.points = s->log.max_beams;
    parameters.keyframes = s->scans;
    parameters.keyframe_points = s->scans * (points < parameters.points ? points : parameters.points);
    return parameters;
}

/* Returns 0, or 1 after a message. */
static int start_slam(session *s)
{
    const ek_slam_parameters parameters = slam_parameters(s);
    ek_status status = ek_slam_bytes(&parameters, &s->memory_bytes);
    if (status == EK_OK) {
        s->tracked = (tracked_scan *)take_memory(s, s->scans * sizeof *s->tracked);
        s->memory = s->tracked ? take_memory(s, s->memory_bytes) : NULL;
        if (!s->memory) {
            return 1;
        }
        status = ek_slam_start(&s->slam, s->memory, s->memory_bytes, &parameters);
    }
    return status == EK_OK ? 0 : print_error(s->paths[0], ek_status_text(status));
}

/* Write the corrected poses, also of the scans before one that cannot be read. Returns 0, or 1 after a message. */
static int run_slam(session *s, int with_map)
{
    s->scans = count_scans(s);
    if (s->scans && start_slam(s)) {
        return 1;
    }
    const int failed = read_scans_again(s, update_slam);
    for (size_t k = 0; k < s->tracked_count; k++) {
        tracked_scan *const now = s->tracked + k;
        now->pose = ek_slam_correct(&s->slam, now->keyframe, now->pose);
        write_pose(s, now->stamp_ns, now->pose);
    }
    return failed || (with_map && draw_map(s));
}

static int write_map(const ek_grid *grid, const char *path)
{
    FILE *const file = fopen(path, "wb");
    if (!file) {
        return print_file_error(path, "cannot be opened for the map");
    }
    const size_t columns = grid->parameters.columns;
    fprintf(file, "P5\n%lu %lu\n255\n", (unsigned long)columns, (unsigned long)grid->parameters.rows);
    for (size_t row = grid->parameters.rows; row-- > 0u && !ferror(file);) {
        for (size_t column = 0; column < columns; column++) {
            const int16_t cell = grid->cells[row * columns + column];
            /* map_server's thresholds 0.65 and 0.196 as log-odds x 1000 */
            fputc(cell == EK_UNKNOWN ? 205 : cell > 619 ? 0 : cell < -1411 ? 254 : 205, file);
        }
    }
    const int failed = ferror(file) ? print_file_error(path, "the map cannot be written") : 0;
    return fclose(file) == 0 || failed ? failed : print_file_error(path, "the map cannot be written");
}

/* Returns 0, or 1 after a message. */
static int take_beams(session *s)
{
    const size_t bytes = s->log.max_beams * sizeof(ek_real);
    s->ranges = (ek_real *)take_memory(s, bytes);
    s->angles = s->ranges ? (ek_real *)take_memory(s, bytes) : NULL;
    return !s->angles;
}

static int process(session *s, char *const *paths, int count)
{
    s->paths = paths;
    s->input = fopen(paths[0], "rb");
    if (!s->input) {
        return print_file_error(paths[0], "the scan log cannot be opened");
    }
    const ek_status status = ek_scanlog_open(s->input, &s->log);
    int failed = status == EK_OK ? take_beams(s) : print_error(paths[0], ek_status_text(status));
    if (!failed) {
        s->poses = fopen(paths[1], "w");
        if (!s->poses) {
            failed = print_file_error(paths[1], "cannot be opened for the poses");
        } else {
            failed = s->use_slam ? run_slam(s, count > 2) : run_pipeline(s);
            if (fclose(s->poses) != 0 && !failed) {
                failed = print_file_error(paths[1], "poses cannot be written");
            }
        }
    }
    fclose(s->input);
    return !failed && count > 2 ? write_map(s->use_slam ? &s->grid : &s->pipeline.grid, paths[2]) : failed;
}

/* Returns the index of the first argument that is no known option. */
static int read_options(session *s, int argc, char **argv)
{
    const struct {
        const char *name;
        int *given;
    } options[] = {{"--bits", &s->bits}, {"--line", &s->line}, {"--slam", &s->use_slam}, {"--polygon", &s->polygon}};
    for (int next = 1; next < argc; next++) {
        size_t k = 0;
        while (k < sizeof options / sizeof *options && strcmp(argv[next], options[k].name) != 0) {
            k++;
        }
        if (k == sizeof options / sizeof *options) {
            return next;
        }
        *options[k].given = 1;
    }
    return argc;
}

int main(int argc, char **argv)
{
    static session s; /* zero-initialised; too large for some stacks */
    const int first = read_options(&s, argc, argv), count = argc - first;
    if (count < 2 || count > 3 || strncmp(argv[first], "--", 2u) == 0 || (s.line && s.use_slam)) {
        fprintf(stderr, "usage: evalkit-run [--bits] [--line | --slam] [--polygon] LOG POSES [MAP]\n");
        return 2;
    }
    const int failed = process(&s, argv + first, count);
    free_memory(&s);
    return failed;
}

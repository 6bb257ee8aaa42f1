/* evalkit-run [--bits] [--line] [--polygon] LOG POSES [MAP]: run the pipeline on a scan log. Writes poses in TUM format and
 * the map as PGM (map_server's trinary values, highest y first). Allocates memory once, at the start.
 *   --bits     a pose is a line of its stamp (ns) and the bits of x, y and theta as double, hexadecimal: equal lines are
 *              equal poses
 *   --line     distances to walls and one lasting map, as embedded-pipeline-line, instead of points and keyframes
 *   --polygon  the map from the outline of each scan instead of its beams */
#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "ek/pipeline.h"
#include "ek/scanlog.h"

typedef struct {
    ek_pipeline pipeline;
    ek_scanlog log;
    ek_real *ranges, *angles;
    void *memory;
    int bits, line, polygon; /* 1: the option was given */
} session;

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

/* Returns 0, or 1 after a message. */
static int start(session *s, const char *log)
{
    ek_pipeline_parameters parameters = ek_pipeline_default();
    size_t bytes;
    if (s->line) {
        parameters.frontend = ek_frontend_lines();
    }
    parameters.grid.polygon = s->polygon;
    parameters.scan.range_min = s->log.range_min;
    parameters.scan.range_max = s->log.range_max;
    parameters.scan.base_from_sensor = s->log.base_from_sensor;
    parameters.frontend.points = s->log.max_beams;
    parameters.grid.range_max = s->log.range_max;
    ek_status status = ek_pipeline_bytes(&parameters, &bytes);
    if (status == EK_OK) {
        s->memory = malloc(bytes);
        s->ranges = (ek_real *)malloc(s->log.max_beams * sizeof(ek_real));
        s->angles = (ek_real *)malloc(s->log.max_beams * sizeof(ek_real));
        if (!s->memory || !s->ranges || !s->angles) {
            fprintf(stderr, "evalkit-run: %s: scans of %lu beams need %lu bytes of memory, which are not free\n", log,
                    (unsigned long)s->log.max_beams,
                    (unsigned long)(bytes + 2u * s->log.max_beams * sizeof(ek_real)));
            return 1;
        }
        status = ek_pipeline_start(&s->pipeline, s->memory, bytes, &parameters);
    }
    return status == EK_OK ? 0 : print_error(log, ek_status_text(status));
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

/* Process all scans of paths[0] into paths[1]. Returns 0, or 1 after a message. */
static int run(session *s, FILE *input, FILE *poses, char *const *paths)
{
    ek_sweep sweep;
    ek_estimate estimate;
    for (unsigned long scan = 1;; scan++) {
        ek_status status = ek_scanlog_next(input, &s->log, s->ranges, s->angles, &sweep);
        if (status == EK_END_OF_FILE) {
            return scan > 1u ? 0 : print_error(paths[0], "a scan log without scans");
        }
        if (status == EK_OK) {
            status = ek_pipeline_update(&s->pipeline, &sweep, &estimate);
        }
        if (status != EK_OK) {
            fprintf(stderr, "evalkit-run: %s: scan %lu: %s\n", paths[0], scan, ek_status_text(status));
            return 1;
        }
        (s->bits ? write_bits : write_tum)(poses, sweep.stamp_ns, estimate.start_from_base);
        if (ferror(poses)) {
            return print_file_error(paths[1], "poses cannot be written");
        }
    }
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

static int process(session *s, char *const *paths, int count)
{
    FILE *const input = fopen(paths[0], "rb");
    if (!input) {
        return print_file_error(paths[0], "the scan log cannot be opened");
    }
    const ek_status status = ek_scanlog_open(input, &s->log);
    int failed = status == EK_OK ? start(s, paths[0]) : print_error(paths[0], ek_status_text(status));
    if (!failed) {
        FILE *const poses = fopen(paths[1], "w");
        failed = poses ? run(s, input, poses, paths) : print_file_error(paths[1], "cannot be opened for the poses");
        if (poses && fclose(poses) != 0 && !failed) {
            failed = print_file_error(paths[1], "poses cannot be written");
        }
    }
    fclose(input);
    return !failed && count > 2 ? write_map(&s->pipeline.grid, paths[2]) : failed;
}

/* Returns the index of the first argument that is no known option. */
static int read_options(session *s, int argc, char **argv)
{
    const struct {
        const char *name;
        int *given;
    } options[] = {{"--bits", &s->bits}, {"--line", &s->line}, {"--polygon", &s->polygon}};
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
    if (count < 2 || count > 3 || strncmp(argv[first], "--", 2u) == 0) {
        fprintf(stderr, "usage: evalkit-run [--bits] [--line] [--polygon] LOG POSES [MAP]\n");
        return 2;
    }
    const int failed = process(&s, argv + first, count);
    free(s.memory);
    free(s.ranges);
    free(s.angles);
    return failed;
}

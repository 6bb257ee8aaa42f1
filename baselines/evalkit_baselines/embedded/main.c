/* evalkit-run LOG POSES [MAP]: run the pipeline on a scan log. Writes poses in TUM format and the map as PGM
 * (map_server's trinary values, highest y first). Allocates memory once, at the start. */
#include <inttypes.h>
#include <stdlib.h>

#include "ek/pipeline.h"
#include "ek/scanlog.h"

typedef struct {
    ek_pipeline pipeline;
    ek_scanlog log;
    ek_real *ranges, *angles;
    void *memory;
} session;

static int print_error(const char *what, ek_status status)
{
    fprintf(stderr, "evalkit-run: %s: %s\n", what, ek_status_text(status));
    return 1;
}

static ek_status start(session *s)
{
    ek_pipeline_parameters parameters = ek_pipeline_default();
    size_t bytes;
    parameters.scan.range_min = s->log.range_min;
    parameters.scan.range_max = s->log.range_max;
    parameters.scan.base_from_sensor = s->log.base_from_sensor;
    parameters.frontend.points = s->log.max_beams;
    parameters.grid.range_max = s->log.range_max;
    const ek_status status = ek_pipeline_bytes(&parameters, &bytes);
    if (status != EK_OK) {
        return status;
    }
    s->memory = malloc(bytes);
    s->ranges = (ek_real *)malloc(s->log.max_beams * sizeof(ek_real));
    s->angles = (ek_real *)malloc(s->log.max_beams * sizeof(ek_real));
    if (!s->memory || !s->ranges || !s->angles) {
        return EK_TOO_LITTLE_MEMORY;
    }
    return ek_pipeline_start(&s->pipeline, s->memory, bytes, &parameters);
}

/* Write seconds with nine decimals (TUM format). */
static void write_stamp(FILE *poses, int64_t stamp_ns)
{
    const uint64_t size = stamp_ns < 0 ? (uint64_t)0 - (uint64_t)stamp_ns : (uint64_t)stamp_ns;
    fprintf(poses, "%s%" PRIu64 ".%09" PRIu64, stamp_ns < 0 ? "-" : "", size / 1000000000u, size % 1000000000u);
}

static ek_status run(session *s, FILE *input, FILE *poses)
{
    ek_sweep sweep;
    ek_estimate estimate;
    for (;;) {
        ek_status status = ek_scanlog_next(input, &s->log, s->ranges, s->angles, &sweep);
        if (status == EK_OK) {
            status = ek_pipeline_update(&s->pipeline, &sweep, &estimate);
        }
        if (status != EK_OK) {
            return status == EK_END_OF_FILE ? EK_OK : status;
        }
        const ek_pose pose = estimate.start_from_base;
        const double half = 0.5 * (double)pose.theta;
        write_stamp(poses, sweep.stamp_ns);
        fprintf(poses, " %.9f %.9f 0 0 0 %.12f %.12f\n", (double)pose.x, (double)pose.y, sin(half), cos(half));
    }
}

static int write_map(const ek_grid *grid, const char *path)
{
    FILE *const file = fopen(path, "wb");
    if (!file) {
        return print_error(path, EK_BAD_FILE);
    }
    const size_t columns = grid->parameters.columns;
    fprintf(file, "P5\n%zu %" PRIu32 "\n255\n", columns, grid->parameters.rows);
    for (size_t row = grid->parameters.rows; row-- > 0u;) {
        for (size_t column = 0; column < columns; column++) {
            const int16_t cell = grid->cells[row * columns + column];
            /* map_server's thresholds 0.65 and 0.196 as log-odds x 1000 */
            fputc(cell == EK_UNKNOWN ? 205 : cell > 619 ? 0 : cell < -1411 ? 254 : 205, file);
        }
    }
    return fclose(file) == 0 ? 0 : print_error(path, EK_BAD_FILE);
}

static int process(session *s, char *const *paths, int count)
{
    FILE *const input = fopen(paths[0], "rb");
    if (!input) {
        return print_error(paths[0], EK_BAD_FILE);
    }
    ek_status status = ek_scanlog_open(input, &s->log);
    if (status == EK_OK) {
        status = start(s);
    }
    FILE *const poses = status == EK_OK ? fopen(paths[1], "w") : NULL;
    if (poses) {
        status = run(s, input, poses);
        status = fclose(poses) == 0 ? status : EK_BAD_FILE;
    } else if (status == EK_OK) {
        fclose(input);
        return print_error(paths[1], EK_BAD_FILE);
    }
    fclose(input);
    if (status != EK_OK) {
        return print_error(paths[0], status);
    }
    return count > 2 ? write_map(&s->pipeline.grid, paths[2]) : 0;
}

int main(int argc, char **argv)
{
    static session s; /* zero-initialised; too large for some stacks */
    if (argc < 3 || argc > 4) {
        fprintf(stderr, "usage: evalkit-run LOG POSES [MAP]\n");
        return 2;
    }
    const int failed = process(&s, argv + 1, argc - 1);
    free(s.memory);
    free(s.ranges);
    free(s.angles);
    return failed;
}

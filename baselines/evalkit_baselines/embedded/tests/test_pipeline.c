#include "check.h"
#include "ek/pipeline.h"
#include "ek/scanlog.h"
#include "walls.h"

#define BEAMS 400u
#define SCANS 40

static void put(FILE *file, uint64_t bits, int bytes)
{
    for (int k = 0; k < bytes; k++) {
        fputc((int)(bits >> (8 * k) & 0xFFu), file);
    }
}

static void put_double(FILE *file, double number)
{
    uint64_t bits;
    memcpy(&bits, &number, sizeof bits);
    put(file, bits, 8);
}

static void put_float(FILE *file, float number)
{
    uint32_t bits;
    memcpy(&bits, &number, sizeof bits);
    put(file, bits, 4);
}

static ek_pose truth_at(double t)
{
    const ek_pose pose = {EK_R(1.0 + 0.04 * t), EK_R(1.2 + 0.01 * t), EK_R(0.02 * t)};
    return pose;
}

/* Scan log of a moving robot: each beam starts at the robot's pose at its firing time. */
static void write_log(FILE *file)
{
    const double head[] = {0.15, 12.0, 0.0, 0.0, 0.0};
    fputs("EKSL", file);
    put(file, 1u, 4);
    put(file, BEAMS, 4);
    for (int k = 0; k < 5; k++) {
        put_double(file, head[k]);
    }
    for (int scan = 0; scan < SCANS; scan++) {
        put(file, (uint64_t)scan * 100000000u, 8);
        put(file, 200000u, 8);
        put(file, BEAMS, 4);
        put(file, 1u, 4);
        const ek_pose odom = ek_se2_between(truth_at(0), truth_at(scan));
        put_double(file, 1.03 * (double)odom.x);
        put_double(file, 1.03 * (double)odom.y);
        put_double(file, 0.97 * (double)odom.theta);
        for (unsigned k = 0; k < BEAMS; k++) {
            const ek_pose pose = truth_at(scan + 0.002 * k);
            put_float(file, (float)range_at(pose, 2.0 * (double)EK_PI * k / BEAMS));
        }
        for (unsigned k = 0; k < BEAMS; k++) {
            put_float(file, (float)(2.0 * (double)EK_PI * k / BEAMS));
        }
    }
}

static void a_log_is_located_and_mapped(FILE *file)
{
    static ek_pipeline pipeline;
    static ek_real ranges[BEAMS], angles[BEAMS];
    ek_scanlog log;
    ek_sweep sweep;
    ek_estimate estimate;
    size_t bytes;
    int scans = 0;
    CHECK(ek_scanlog_open(file, &log) == EK_OK && log.max_beams == BEAMS);
    ek_pipeline_parameters parameters = ek_pipeline_default();
    parameters.frontend.points = log.max_beams;
    parameters.frontend.scan_to_scan.epsilon = parameters.frontend.scan_to_map.epsilon = EK_R(1e-6);
    CHECK(ek_pipeline_bytes(&parameters, &bytes) == EK_OK);
    ek_arena arena = memory_of(bytes);
    CHECK(ek_pipeline_start(&pipeline, arena.memory, bytes - 1u, &parameters) == EK_TOO_LITTLE_MEMORY);
    CHECK(ek_pipeline_start(&pipeline, arena.memory, bytes, &parameters) == EK_OK);
    while (ek_scanlog_next(file, &log, ranges, angles, &sweep) == EK_OK) {
        CHECK(ek_pipeline_update(&pipeline, &sweep, &estimate) == EK_OK);
        scans++;
    }
    const ek_pose truth = ek_se2_between(truth_at(0), truth_at(SCANS - 1));
    CHECK(scans == SCANS);
    CHECK_NEAR(estimate.start_from_base.x, truth.x, 0.03);
    CHECK_NEAR(estimate.start_from_base.y, truth.y, 0.03);
    CHECK_NEAR(estimate.start_from_base.theta, truth.theta, 0.02);
    /* the wall x = 0 is 1 m behind the start; the floor is free */
    const ek_grid *const grid = &pipeline.grid;
    const size_t row = (size_t)(0 - grid->bottom) * grid->parameters.columns;
    int16_t wall = 0;
    for (int32_t column = -22; column <= -19; column++) {
        const int16_t cell = grid->cells[row + (size_t)(column - grid->left)];
        wall = cell > wall ? cell : wall;
    }
    CHECK(wall > 2000);
    CHECK(grid->cells[row + (size_t)(10 - grid->left)] < -2000);
    sweep.time_increment_ns = -1;
    CHECK(ek_pipeline_update(&pipeline, &sweep, &estimate) == EK_OUT_OF_RANGE);
    free(arena.memory);
}

static void a_damaged_log_is_refused(FILE *file)
{
    ek_scanlog log;
    ek_sweep sweep;
    ek_real ranges[1], angles[1];
    rewind(file);
    CHECK(ek_scanlog_open(file, &log) == EK_OK);
    log.max_beams = 1u; /* more beams than the capacity */
    CHECK(ek_scanlog_next(file, &log, ranges, angles, &sweep) == EK_BAD_FILE);
    rewind(file);
    fputs("PNG", file);
    rewind(file);
    CHECK(ek_scanlog_open(file, &log) == EK_BAD_FILE);
}

/* 2^30 cells of two bytes: half of what 32 bits address. */
static void sizes_that_cannot_be_addressed_are_refused(void)
{
    ek_pipeline_parameters parameters = ek_pipeline_default();
    size_t bytes = 1u;
    parameters.grid.columns = parameters.grid.rows = 32768u;
    const ek_status status = ek_pipeline_bytes(&parameters, &bytes);
    if (SIZE_MAX > UINT32_MAX) {
        CHECK(status == EK_OK && bytes / 2u > (size_t)1 << 30);
    } else {
        CHECK(status == EK_OUT_OF_RANGE && bytes == 0u);
    }
    parameters.map = 0; /* and the points of all keyframes */
    parameters.frontend.points = (size_t)1 << 20;
    parameters.frontend.keyframes = 1024u;
    CHECK(ek_pipeline_bytes(&parameters, &bytes) == (SIZE_MAX > UINT32_MAX ? EK_OK : EK_OUT_OF_RANGE));
    parameters.frontend.keyframes = 16u; /* 2^24 points: 16 cells each would be 2^28, the most are 2^18 */
    CHECK(ek_pipeline_bytes(&parameters, &bytes) == EK_OK && bytes < (size_t)1 << 31);
}

int main(void)
{
    sizes_that_cannot_be_addressed_are_refused();
    FILE *const file = tmpfile();
    if (!file) {
        return EXIT_FAILURE;
    }
    write_log(file);
    rewind(file);
    a_log_is_located_and_mapped(file);
    a_damaged_log_is_refused(file);
    fclose(file);
    return verdict();
}

/* Instructions and stack of count.c, on a board. */
#include "count.h"

#ifdef BOARD_COUNT
#include <stdio.h>
#include <string.h>

#include "ek/table.h"
#include "port.h"

#define PAINT 0xA5A5A5A5u
#define PAINTED 4096 /* words; more than a scan needs */

static uint64_t instructions; /* of the last call */

void init_board(void)
{
    port_init();
}

void print_bound(scan_bound bound)
{
    (void)bound;
}

void print_shares(void)
{
}

/* Bytes of the stack that a call takes below this function. Nothing interrupts the emulated processor. */
static unsigned long __attribute__((noinline)) stack_of(scan_call call, void *context, ek_status *status)
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

int count_scan(scan_call call, const ek_sweep *sweep, scan_bound bound, int silent)
{
    (void)bound;
    ek_sweep copy = *sweep;
    ek_status status;
    const unsigned long stack = stack_of(call, &copy, &status);
    if (!silent) {
        printf("%llu %lu\n", (unsigned long long)instructions, stack);
    }
    return status == EK_OK ? 0 : fail("update", status);
}

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
    int failed = status == EK_OK ? begin_pipeline(&parameters) : fail("bytes", status);
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
        const unsigned long stack = stack_of(call_pipeline, &sweep, &status);
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

static size_t bytes_of_slam;

static ek_status call_slam_bytes(void *parameters)
{
    return ek_slam_bytes((const ek_slam_parameters *)parameters, &bytes_of_slam);
}

static ek_status call_slam_start(void *parameters)
{
    return ek_slam_start(&slam, aligned, bytes_of_slam, (const ek_slam_parameters *)parameters);
}

static int print_stack_of_slam(void)
{
    ek_slam_parameters parameters = slam_parameters("slam");
    ek_status status;
    const unsigned long bytes = stack_of(call_slam_bytes, &parameters, &status);
    if (status == EK_OK) {
        status = take_memory(bytes_of_slam) ? EK_OK : EK_TOO_LITTLE_MEMORY;
    }
    const unsigned long start = status == EK_OK ? stack_of(call_slam_start, &parameters, &status) : 0u;
    printf("%lu %lu\n", bytes, start);
    return status == EK_OK ? 0 : fail("start", status);
}

int print_stack(void)
{
    seed_numbers(0u);
    return print_stack_of_pipeline(configured("360")) || print_stack_of_pipeline(configured("360-lines-polygon")) ||
           print_stack_of_table() || print_stack_of_slam();
}
#else
#include <stdio.h>

void init_board(void)
{
}

int print_stack(void)
{
    fprintf(stderr, "count: stack: on a board only\n");
    return 1;
}
#endif

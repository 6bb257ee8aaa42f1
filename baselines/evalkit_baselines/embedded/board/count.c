/* count - the work of each scan, over a recording or over random scans. On a board (BOARD_COUNT, with port.h) a
 * line per scan has its instructions and the depth of its stack in bytes; compiled with EK_TALLY it has the tallies of
 * its loops, and a scan that exceeds their bound is an error. Both see the same bits, and hence the same loops, if
 * compiled with EK_PORTABLE. Usage:
 *
 *     count sizes CONFIGURATION        print the bytes of the struct and of its memory, and the bounds of the tallies
 *     count log CONFIGURATION FILE     a recording (scanlog.h)
 *     count random KIND SEED SESSIONS  sessions of random scans with random parameters: of 20 scans with points (and
 *                                      keyframes), or lines (most with lines and a lasting map, half of them with polygons);
 *                                      slam: random drives of 100 scans with ek_slam
 *     count bound KIND SEED SESSIONS   the same, and print only the number of scans and the largest share of each bound
 *     count stack                      on a board: print the stack of ek_pipeline_bytes, _start and _update with points
 *                                      and keyframes, then with lines and a lasting map, of ek_icp_register with a table, and of
 *                                      ek_slam_bytes and _start
 *
 * A CONFIGURATION is one of count_pipeline.c, or ek_slam: slam (in the memory of small_slam.h) or slam-default.
 */
#include "count.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ek/scanlog.h"

ek_real ranges[MAX_BEAMS], angles[MAX_BEAMS];
unsigned char *aligned; /* newlib aligns to 8 bytes only */
static void *memory;
static uint64_t state; /* of the random numbers */

void seed_numbers(uint64_t seed)
{
    state = seed * 0x9E3779B97F4A7C15u + 1u;
}

/* The same numbers on every processor (Marsaglia 2003, xorshift64). */
double uniform(double low, double high)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return low + (high - low) * ((double)(state >> 11) / 9007199254740992.0);
}

uint32_t whole(uint32_t low, uint32_t high)
{
    return (uint32_t)uniform((double)low, (double)high + 1.0);
}

int fail(const char *what, ek_status status)
{
    fprintf(stderr, "count: %s: %s\n", what, ek_status_text(status));
    return 1;
}

unsigned char *take_memory(size_t bytes)
{
    free(memory);
    memory = malloc(bytes + EK_ALIGNMENT);
    aligned = memory ? (unsigned char *)memory + (EK_ALIGNMENT - (uintptr_t)memory % EK_ALIGNMENT) : NULL;
    return aligned;
}

double range_in_room(double x, double y, double c, double s)
{
    const double across = ((c > 0.0 ? 4.0 : -4.0) - x) / (c < 0.0 || c > 0.0 ? c : 1e-9);
    const double up = ((s > 0.0 ? 3.0 : -3.0) - y) / (s < 0.0 || s > 0.0 ? s : 1e-9);
    return across < up ? across : up;
}

void draw_scan(scan_kind kind, int number, size_t beams, double range_max)
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

int run_log(begin_log first, log_step step, const char *name, const char *path)
{
    ek_scanlog log;
    ek_sweep sweep;
    FILE *const file = fopen(path, "rb");
    ek_status status = file ? ek_scanlog_open(file, &log) : EK_BAD_FILE;
    if (status != EK_OK || log.max_beams > MAX_BEAMS) {
        return fail(path, status == EK_OK ? EK_TOO_MANY_POINTS : status);
    }
    const ek_scan_parameters scan = {log.base_from_sensor, log.range_min, log.range_max, EK_R(0.0)};
    int failed = first(name, &scan);
    while (!failed && status == EK_OK) {
        status = ek_scanlog_next(file, &log, ranges, angles, &sweep);
        failed = status == EK_OK ? step(&sweep, 0) : status == EK_END_OF_FILE ? 0 : fail(path, status);
    }
    fclose(file);
    return failed;
}

/* Print random scans of a kind, or `silent` how near they come to their bounds. */
static int run_random(const char *kind, const char *seed, long sessions, int silent)
{
    const int drives = strcmp(kind, "slam") == 0, lines = strcmp(kind, "lines") == 0;
    seed_numbers(strtoull(seed, NULL, 10));
    const int failed = drives ? random_slams(sessions, silent) : random_pipelines(lines, sessions, silent);
    if (silent && !failed) {
        print_shares();
    }
    return failed;
}

static int is_kind(const char *kind)
{
    return strcmp(kind, "points") == 0 || strcmp(kind, "lines") == 0 || strcmp(kind, "slam") == 0;
}

int main(int argc, char **argv)
{
    const char *const what = argc > 1 ? argv[1] : "", *const name = argc > 2 ? argv[2] : "";
    const int silent = strcmp(what, "bound") == 0, known = is_slam(name) || is_pipeline(name);
    int failed = 2;
    init_board();
    if (strcmp(what, "sizes") == 0 && argc == 3 && known) {
        failed = is_slam(name) ? print_slam(name) : print_pipeline(name);
    } else if (strcmp(what, "log") == 0 && argc == 4 && known) {
        failed = is_slam(name) ? log_slam(name, argv[3]) : log_pipeline(name, argv[3]);
    } else if (strcmp(what, "stack") == 0 && argc == 2) {
        failed = print_stack();
    } else if ((silent || strcmp(what, "random") == 0) && is_kind(name) && argc == 5) {
        failed = run_random(name, argv[3], strtol(argv[4], NULL, 10), silent);
    } else {
        fprintf(stderr, "usage: count sizes CONFIGURATION | log CONFIGURATION FILE | "
                        "random|bound points|lines|slam SEED SESSIONS | stack\n");
    }
    free(memory);
    return failed;
}

/* Tallies of count.c, and their bounds in BOARD.md for a scan of the pipeline. */
#include "count_bound.h"

#ifdef EK_TALLY
#include <stdio.h>
#include <string.h>

uint64_t ek_tally[EK_TALLIES];
static double largest[EK_TALLIES]; /* share of the bound */

uint64_t smaller(uint64_t a, uint64_t b)
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

uint64_t larger(uint64_t a, uint64_t b)
{
    return a > b ? a : b;
}

target_size target_of(uint64_t points, const ek_index *index, double span)
{
    const target_size target = {points, index->cell_capacity,
                                span > 0.0 ? smaller(index->cell_capacity, (uint64_t)(1125.0 * span) + 8u)
                                           : index->cell_capacity};
    return target;
}

void add_searches(uint64_t searches, double limit, target_size target, uint64_t most[EK_TALLIES])
{
    const uint64_t looks = 3u + doublings(0.00075, limit + 0.01), across = 6u * (uint64_t)(1000.0 * (limit + 0.01)); /* 1 mm */
    most[EK_SEARCHES] += searches;
    most[EK_ROWS] += searches * smaller(across + 2u * looks, looks * target.cells);
    most[EK_CANDIDATES] += searches * looks * target.points;
}

void add_normals(uint64_t normals, uint64_t neighbours, target_size target, uint64_t most[EK_TALLIES])
{
    const uint64_t looks = 2u + doublings(0.25, (double)target.longest), candidates = normals * looks * target.points;
    most[EK_NORMALS] += normals;
    most[EK_ROWS] += normals * (5u * target.longest + 2u * looks);
    most[EK_CANDIDATES] += candidates;
    most[EK_RANKED] += neighbours * (candidates + normals);
}

void add_iterations(uint64_t times, uint64_t iterations, uint64_t points, int lines, uint64_t most[EK_TALLIES])
{
    most[EK_ITERATIONS] += times * iterations;
    most[EK_POINTS] += times * EK_PADDED(points) * (iterations + 1u);
    most[EK_FITS] += lines ? times * iterations : 0u;
    most[EK_FITTED] += lines ? times * EK_PADDED(points) * iterations : 0u;
}

/* Add the work of a stage of the pipeline. */
static void add_stage(const ek_icp_parameters *stage, uint64_t beams, uint64_t neighbours, target_size target,
                      uint64_t most[EK_TALLIES])
{
    const uint64_t iterations = (uint64_t)stage->max_iterations, searches = beams * iterations;
    const int lines = stage->metric == EK_METRIC_LINE;
    add_iterations(1u, iterations, beams, lines, most);
    add_searches(searches, (double)stage->max_correspondence, target, most);
    if (lines) {
        add_normals(smaller(searches, target.points), neighbours, target, most);
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
void bound_pipeline(uint64_t most[EK_TALLIES])
{
    const ek_frontend *const f = &pipeline.frontend;
    const ek_lasting_map *const map = &f->lasting;
    const uint64_t beams = f->parameters.points, neighbours = f->parameters.neighbours;
    const target_size last = target_of(beams, &f->last, 0.0);
    target_size local = target_of(beams * f->parameters.keyframes, &f->local_map, 0.0);
    memset(most, 0, EK_TALLIES * sizeof *most);
    most[EK_SCANS] = 1u;
    most[EK_BEAMS] = beams;
    if (map->capacity) {
        local = target_of(map->capacity, &map->around, 2.0 * (double)map->radius);
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

int count_scan(scan_call call, const ek_sweep *sweep, scan_bound bound, int silent)
{
    ek_sweep copy = *sweep;
    uint64_t most[EK_TALLIES];
    memset(ek_tally, 0, sizeof ek_tally);
    const ek_status status = call(&copy);
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

void print_bound(scan_bound bound)
{
    uint64_t most[EK_TALLIES];
    bound(most);
    for (int k = 0; k < EK_TALLIES; k++) {
        printf(" %llu", (unsigned long long)most[k]);
    }
}

void print_shares(void)
{
    for (int k = 0; k < EK_TALLIES; k++) {
        printf("%s%.4f", k ? " " : "", largest[k]);
    }
    putchar('\n');
}
#else
void bound_pipeline(uint64_t most[EK_TALLIES])
{
    (void)most;
}
#endif

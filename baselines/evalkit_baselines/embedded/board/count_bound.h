/* count_bound.h - what the bounds of count_bound.c (pipeline) and count_slam_bound.c share. */
#ifndef COUNT_BOUND_H
#define COUNT_BOUND_H

#include "count.h"

/* What points are searched in. */
typedef struct {
    uint64_t points, cells, longest; /* at most; longest: rows or columns of its cells */
} target_size;

uint64_t smaller(uint64_t a, uint64_t b);
uint64_t larger(uint64_t a, uint64_t b);

/* The target that an index holds; `span` (m): of its points, 0: unknown. Cells have at least 1 mm, and there is a border. */
target_size target_of(uint64_t points, const ek_index *index, double span);

/* Add searches of a nearest neighbour within a limit (m). One looks around in squares of twice the size each, from 0.75 of a cell
 * of at least 1 mm to the limit, and once more where two points are equally near. */
void add_searches(uint64_t searches, double limit, target_size target, uint64_t most[EK_TALLIES]);

/* Add normals of lines: a search for neighbours goes from a quarter of a cell to all cells. */
void add_normals(uint64_t normals, uint64_t neighbours, target_size target, uint64_t most[EK_TALLIES]);

/* Add so many registrations of points in so many iterations, without what they search. */
void add_iterations(uint64_t times, uint64_t iterations, uint64_t points, int lines, uint64_t most[EK_TALLIES]);

#endif

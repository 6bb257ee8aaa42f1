/* tally.h - count the passes of the loops of a scan, to check a bound of its work (board/count.c).
 *
 * Compiled in with -DEK_TALLY, for a program that defines ek_tally; otherwise nothing is left of it.
 */
#ifndef EK_TALLY_H
#define EK_TALLY_H

#include <stdint.h>

typedef enum {
    EK_SCANS,      /* calls of ek_pipeline_update */
    EK_BEAMS,      /* beams, in the loops that run once per scan */
    EK_ITERATIONS, /* of a registration */
    EK_POINTS,     /* points of an iteration, and once before the first */
    EK_FITS,       /* iterations that fit lines */
    EK_FITTED,     /* points of such an iteration */
    EK_SEARCHES,   /* of a nearest neighbour */
    EK_ROWS,       /* rows of cells in searches of a nearest neighbour, or of those that define a line */
    EK_CANDIDATES, /* points compared in both */
    EK_NORMALS,    /* of lines */
    EK_RANKED,     /* places that candidates of a line are compared with, and points of the line */
    EK_SLOTS,      /* points in loops that build or update an index */
    EK_CELLS,      /* cells in such loops; entries of a table that are cleared or summed up, words that are copied */
    EK_ADDED,      /* points added to a lasting map; twice where it keeps from where they were seen */
    EK_PROBES,     /* entries of its hash table looked at */
    EK_VOXELS,     /* voxels looked at to find those around the robot; twice where from where they were seen is kept */
    EK_CORNERS,    /* beams that define an outline */
    EK_STEPS,      /* of beams and edges of an outline through the window of the map: lines and words */
    EK_WORDS,      /* of the window, and of outlines that are filled */
    EK_FILLED,     /* words with marks, that change 32 cells of the map */
    EK_SLAM_SCANS, /* calls of ek_slam_update */
    EK_PREPARED,   /* beams that are smoothed, and searched for speckles and for what moves along */
    EK_LOOKUPS,    /* points looked up in a score grid */
    EK_OPERATIONS, /* of work.h, of loops without a tally */
    EK_TASK,       /* of work.h, all that a scan spends on loops, optimisation and map: tallied above, once more */
    EK_TALLIES
} ek_tally_kind;

#ifdef EK_TALLY
extern uint64_t ek_tally[EK_TALLIES];
#define EK_COUNT(kind, passes) (ek_tally[kind] += (uint64_t)(passes))
#else
#define EK_COUNT(kind, passes) ((void)0)
#endif

#endif

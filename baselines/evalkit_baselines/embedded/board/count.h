/* count.h - parts of the program count: count.c (command line, random numbers, scans), count_pipeline.c and count_slam.c (what
 * is counted); with EK_TALLY count_bound.c and count_slam_bound.c (tallies and their bounds); on a board count_board.c
 * (instructions and stack). */
#ifndef COUNT_H
#define COUNT_H

#include "ek/pipeline.h"
#include "ek/slam.h"
#include "ek/tally.h"

#define MAX_BEAMS 2048u
#define SCANS 20 /* of a session of a pipeline */

typedef enum { ROOM, ANYWHERE, CIRCLE, CLUSTER, ONE_PLACE, WALL, KINDS } scan_kind;

extern ek_pipeline pipeline;
extern ek_slam slam;
extern ek_real ranges[MAX_BEAMS], angles[MAX_BEAMS];
extern unsigned char *aligned; /* the memory that was taken, at a multiple of EK_ALIGNMENT */

/* count.c */
void seed_numbers(uint64_t seed);
double uniform(double low, double high);      /* in [low, high) */
uint32_t whole(uint32_t low, uint32_t high);  /* both included */
int fail(const char *what, ek_status status); /* says so on the standard error; 1 */
unsigned char *take_memory(size_t bytes);     /* instead of the last; NULL if there is too little */

/* Draw the beams of a scan of a room of 8 m x 6 m, or of a kind that makes searches look at many cells or at many points. */
void draw_scan(scan_kind kind, int number, size_t beams, double range_max);

/* Range in that room, from x, y in the direction of a cosine and a sine. */
double range_in_room(double x, double y, double c, double s);

typedef int (*begin_log)(const char *name, const ek_scan_parameters *scan);
typedef int (*log_step)(const ek_sweep *sweep, int silent);
int run_log(begin_log first, log_step step, const char *name, const char *path);

/* Process a scan by a call, and print its tallies, or its instructions and its stack, unless `silent`; 1: the scan was
 * refused, or exceeds what `bound` allows. In count_bound.c and in count_board.c. */
typedef ek_status (*scan_call)(void *sweep);
typedef void (*scan_bound)(uint64_t most[EK_TALLIES]);
int count_scan(scan_call call, const ek_sweep *sweep, scan_bound bound, int silent);
void print_bound(scan_bound bound); /* of the tallies, if there are any */
void print_shares(void);            /* the largest share of each bound */

/* count_pipeline.c */
int is_pipeline(const char *name);
ek_pipeline_parameters configured(const char *name);
ek_status call_pipeline(void *sweep);
int begin_pipeline(const ek_pipeline_parameters *parameters);
int print_pipeline(const char *name);                                  /* sizes and bounds */
int log_pipeline(const char *name, const char *path);
int random_pipelines(int lines, long sessions, int silent);

/* count_slam.c */
int is_slam(const char *name);
int print_slam(const char *name);
int log_slam(const char *name, const char *path);
int random_slams(long sessions, int silent);
ek_status call_slam(void *sweep);
ek_slam_parameters slam_parameters(const char *name);

/* count_bound.c, count_slam_bound.c: what a scan of the pipeline, or of the SLAM, may have at most */
void bound_pipeline(uint64_t most[EK_TALLIES]);
void bound_slam(uint64_t most[EK_TALLIES]);

/* count_board.c */
void init_board(void);
int print_stack(void);

#endif

/* The bounds of the tallies of count.c in BOARD.md for a scan of the SLAM. */
#include "count_bound.h"

#ifdef EK_TALLY
#include "../src/slam_parts.h"

#include <string.h>

#define NEIGHBOURS 8u       /* of a normal */
#define ASKED 399u          /* points that are asked where the track may be lost, at most */
#define MEASURED 200u       /* normals of the observer, at most */
#define FEW_ITERATIONS 5u   /* of all points */
#define PART_ITERATIONS 20u /* of a part */
#define TRIED 199u          /* points of a scan that is searched on the map, at most */
#define SEARCH_TIMES 10u    /* the work of that search, in times that allowed to a scan */
#define SAMPLE 599u         /* points that are searched for in the score grid, at most */
#define COVERS 7000u        /* as slots: grids that are tried while an index is built */
#define DIGITS 24576u       /* entries of the tables that sort the points of a thinned cloud, at most */

/* The number of points that are left of `count` if every n-th is taken so that `enough` are. */
static uint64_t part_of(uint64_t count, uint64_t enough)
{
    const uint64_t every = larger(count / enough, 1u);
    return (count + every - 1u) / every;
}

/* Searches of points of a scan in the scan before and in the map. */
typedef struct {
    uint64_t last, map;
} scan_searches;

/* Add the iterations of a stage; returns its searches. `all`: a large scan is then matched with all points. */
static uint64_t add_match(const ek_slam_parameters *p, uint64_t count, int all, uint64_t most[EK_TALLIES])
{
    const uint64_t iterations = (uint64_t)p->matcher.max_iterations, part = part_of(count, 200u), large = part < count;
    const uint64_t first = large ? smaller(iterations, PART_ITERATIONS) : iterations, then = smaller(iterations, FEW_ITERATIONS);
    add_iterations(1u, first, part, 1, most);
    if (large && all) {
        add_iterations(1u, then, count, 1, most);
    }
    return part * first + (large && all ? count * then : 0u);
}

/* Add further tries from so many starts, and a match from the best; returns their searches. */
static uint64_t add_tries(const ek_slam_parameters *p, uint64_t count, uint64_t starts, int all, uint64_t most[EK_TALLIES])
{
    const uint64_t iterations = smaller((uint64_t)p->matcher.max_iterations, PART_ITERATIONS), part = part_of(count, 100u);
    add_iterations(starts, iterations, part, 1, most);
    return starts * part * (iterations + 1u) + add_match(p, count, all, most) + 2u * count;
}

typedef enum { MEASURED_LAST, MEASURED_MAP, NOT_MEASURED, WAYS } matching_way;

/* Add the iterations of matching a scan of so many points: with odometry first directly, then in two stages of which one tries
 * further starts; or without it, where both do. */
static scan_searches add_matching(const ek_slam_parameters *p, uint64_t count, matching_way way, uint64_t most[EK_TALLIES])
{
    scan_searches searches = {add_match(p, count, 0, most), add_match(p, count, 1, most)};
    if (way != NOT_MEASURED) {
        const uint64_t few = smaller((uint64_t)p->matcher.max_iterations, FEW_ITERATIONS);
        add_iterations(1u, few, count, 1, most);
        searches.map += count * few;
    }
    if (way != MEASURED_MAP) {
        searches.last += add_tries(p, count, 5u, 0, most);
    }
    if (way != MEASURED_LAST) {
        searches.map += add_tries(p, count, way == NOT_MEASURED ? 6u : 5u, 1, most);
    }
    if (way == NOT_MEASURED) { /* from where the search of the map ends */
        searches.map += add_match(p, count, 1, most);
    }
    return searches;
}

static double largest_limit(const ek_slam_parameters *p)
{
    const double coarse = (double)p->matcher.max_correspondence, fine = (double)p->fine_correspondence;
    const double both = coarse > fine ? coarse : fine;
    return both > 0.25 ? both : 0.25; /* m: of a point that is on the scan before */
}

/* Add all that searches the scan before and the map: matching, what is open (twice for the map), whether the track is lost, and
 * the times of beams. */
static void add_front(uint64_t count, matching_way way, uint64_t most[EK_TALLIES])
{
    const ek_slam_parameters *const p = &slam.parameters;
    const double limit = largest_limit(p), span = 2.0 * (double)p->map_radius;
    const target_size last = target_of(p->points, &slam.last, 0.0), map = target_of(p->map_points, &slam.map_index, span);
    const target_size before = target_of(p->points, &slam.continuity.before, 0.0);
    scan_searches searches = add_matching(p, count, way, most);
    add_normals(smaller(searches.last, last.points), NEIGHBOURS, last, most);
    add_normals(smaller(searches.map, 2u * map.points), NEIGHBOURS, map, most);
    const uint64_t open = smaller(count, MEASURED), asked = smaller(count, ASKED);
    add_searches(searches.last + open, limit, last, most);
    add_searches(searches.map + 3u * open + asked, limit, map, most);
    add_searches(2u * asked, limit, before, most);
}

/* Take the larger of each tally of the ways to match scans of up to so many points. */
static void bound_front(uint64_t points, uint64_t most[EK_TALLIES])
{
    for (uint64_t count = 1u; count <= points; count++) {
        for (int way = 0; way < WAYS; way++) {
            uint64_t one[EK_TALLIES] = {0u};
            add_front(count, (matching_way)way, one);
            for (int k = 0; k < EK_TALLIES; k++) {
                most[k] = larger(most[k], one[k]);
            }
        }
    }
}

/* Operations of a new keyframe: thinned, measured, kept, drawn, and a place for a loop sought. */
static uint64_t insert_work(const ek_slam_parameters *p)
{
    return 53u * p->points + 160u * (MEASURED + 1u) + 5u * p->keyframes;
}

/* Operations between two questions whether work is left: the solver's last ones, and what ends a run; */
static uint64_t solver_part(const ek_slam_parameters *p)
{
    const uint64_t poses = p->keyframes, loops = p->loops, weigh = 12u * loops + 1u, block = 4u * loops + 20u;
    return larger(larger(weigh, block), poses + 2u * loops) + (3u + EK_MOVE_WORK) * poses +
           (loops + 1u) * (2u * poses + loops) + 4u * loops;
}

/* and of the finder without the index of the target and the matches, which have tallies of their own. */
static uint64_t finder_part(const ek_slam_parameters *p)
{
    const uint64_t points = p->loop_points, joined = EK_MOVE_WORK * p->keyframes, take = p->points + 4u + 8u * points;
    const uint64_t draw = 100u * points + p->score_cells / 8u, judge = 48u * points + 160u * (MEASURED + 1u) + joined;
    const uint64_t look = 50u * (p->points + points) + joined, search = 72u * smaller(points, SAMPLE);
    return larger(larger(take, draw), larger(judge, larger(look, search)));
}

/* Operations that a scan may have for tasks before the last part of its slice. */
static uint64_t allowed_work(void)
{
    const int64_t allowed = ek_slam_allowed_work(&slam);
    return slam.finder.apart ? 4u * (uint64_t)allowed : (uint64_t)allowed;
}

static uint64_t allowed_before; /* work that was allowed to the last scan: a scan is searched on the map before its interval counts */

/* The bounds of BOARD.md for a scan of the SLAM, where `work` and the limits of correspondences are above 0. */
void bound_slam(uint64_t most[EK_TALLIES])
{
    const ek_slam_parameters *const p = &slam.parameters;
    const uint64_t beams = p->points, points = p->loop_points, iterations = (uint64_t)p->matcher.max_iterations;
    const uint64_t allowed = allowed_work(), insert = insert_work(p), part = larger(solver_part(p), finder_part(p));
    const uint64_t match = 12u * (iterations + 1u) * points, whole_part = larger(part, larger(match, 160u * points));
    memset(most, 0, EK_TALLIES * sizeof *most);
    bound_front(beams, most);
    /* a loop: two matches, or what `work` leaves of them, the index of its target, and a verdict */
    const target_size target = target_of(points, &slam.finder.index, 0.0), scan = target_of(beams, &slam.observer.index, 0.0);
    const target_size seen = target_of(points, &slam.finder.observer.index, 0.0);
    const uint64_t searches = smaller(2u * iterations * points, allowed / 12u + iterations * points);
    most[EK_ITERATIONS] += 2u * iterations;
    most[EK_FITS] += 2u * iterations;
    most[EK_POINTS] += searches + 2u * points + 2u * EK_LANES * (iterations + 1u);
    most[EK_FITTED] += searches + 2u * EK_LANES * iterations;
    add_searches(searches + points, largest_limit(p), target, most);
    add_normals(points, NEIGHBOURS, target, most);
    add_normals(2u * MEASURED, NEIGHBOURS, scan, most);
    add_normals(MEASURED, NEIGHBOURS, seen, most);
    /* indices: of the scan before, of the map up to three times, of what was seen there, of two takes of the observer and one of
     * the finder's, of the target */
    const uint64_t map_cells = slam.map_index.cell_capacity, poses = p->keyframes;
    most[EK_SLOTS] = 6u * (4u * beams + 3u * p->map_points + 2u * points) + 9u * COVERS;
    most[EK_CELLS] = 5u * (slam.last.cell_capacity + 3u * map_cells + 3u * scan.cells + seen.cells + target.cells) + 9u * 8u;
    most[EK_CELLS] += 10u * DIGITS + 2u * (slam.maps[0].mask + 1u) + 3u * poses * sizeof(ek_pose) / sizeof(uint32_t);
    most[EK_BEAMS] = most[EK_PREPARED] = beams;
    const uint64_t kept = smaller(p->keyframe_points, poses * beams), drawn = beams + smaller(kept, allowed / 8u + beams);
    most[EK_ADDED] = 2u * drawn;
    most[EK_PROBES] = drawn * (p->voxels + 1u);
    most[EK_VOXELS] = 2u * 3u * p->voxels;
    most[EK_SLAM_SCANS] = 1u;
    const uint64_t allowed_now = (uint64_t)ek_slam_allowed_work(&slam), search = SEARCH_TIMES * larger(allowed_before, allowed_now);
    most[EK_LOOKUPS] = allowed + 64u * smaller(points, SAMPLE) + search + 64u * TRIED;
    most[EK_OPERATIONS] = 124u * beams + larger(allowed + part, insert) + 3u * poses;
    most[EK_OPERATIONS] += search + 8u * TRIED + 100u * p->map_points + p->score_cells;
    allowed_before = allowed_now;
    most[EK_TASK] = larger(allowed + whole_part, insert);
}
#else
void bound_slam(uint64_t most[EK_TALLIES])
{
    (void)most;
}
#endif

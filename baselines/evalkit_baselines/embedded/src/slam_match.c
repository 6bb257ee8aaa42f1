/* The matches of slam.h: of a scan with the one before and with the map, with further tries (second_try.py), and directly. */
#include "slam_parts.h"

#define POOR EK_R(0.1)       /* m: a larger mean distance is doubted, and one of EK_UNUSUAL times the usual error */
#define NEAR EK_R(0.15)      /* m: of several answers, the one with most points within it is taken, */
#define CLOSE EK_R(0.1)      /* m: or, on the map without odometry, the one that lies most closely on it, up to here */
#define COARSE_POINTS 200u   /* a scan of twice as many points or more is matched first with every n-th of them, */
#define FINE_ITERATIONS 5    /* then, with the map, with all; as every scan directly from good odometry */
#define DIRECT_EPSILON EK_R(1e-4) /* m: of the stop rule there */
#define TRIED_POINTS 100u    /* the same for the further tries: the best of them is matched to the end */
#define PART_ITERATIONS 20   /* with a part of a scan */
#define PAIRED_SHARE EK_R(0.8) /* of the points: with pairs for fewer a match is doubted */

static const ek_real TURNS[] = {EK_R(0.0), EK_R(-12.0), EK_R(12.0), EK_R(-24.0), EK_R(24.0)}; /* deg: of further tries */

int ek_slam_is_paired(const ek_match *match, size_t points)
{
    return (ek_real)match->inliers >= PAIRED_SHARE * (ek_real)points;
}

/* How well a scan lies on a target: its number of points within NEAR; `closely`: within CLOSE, where each counts in
 * proportion to how much nearer it is than that. */
static ek_real rate(const ek_index *target, const ek_real *xy, size_t count, ek_pose pose, int closely)
{
    const ek_real c = EK_COS(pose.theta), s = EK_SIN(pose.theta), limit = closely ? CLOSE : NEAR;
    ek_real sum = EK_R(0.0);
    for (size_t k = 0; k < count; k++) {
        const ek_real x = xy[2u * k], y = xy[2u * k + 1u];
        const ek_neighbour nearest =
            ek_index_nearest(target, c * x - s * y + pose.x, s * x + c * y + pose.y, limit, limit);
        sum += nearest.slot == EK_NONE ? EK_R(0.0) : closely ? EK_R(1.0) - nearest.distance / CLOSE : EK_R(1.0);
    }
    return sum;
}

/* 1 where a further try has not left its place. */
static int is_close(ek_pose guess, ek_pose answer)
{
    const ek_pose gap = ek_se2_between(guess, answer);
    return gap.x * gap.x + gap.y * gap.y <= EK_FARTHEST * EK_FARTHEST && EK_FABS(gap.theta) <= EK_FARTHEST_THETA;
}

/* Copy every n-th point of the scan to `moved`, so that `enough` are left, and less than twice as many; their number. */
static size_t take_part(ek_slam *slam, size_t enough)
{
    const size_t every = slam->scan.count / enough > 1u ? slam->scan.count / enough : 1u;
    size_t count = 0u;
    for (size_t k = 0; k < slam->scan.count; k += every, count++) {
        slam->moved[2u * count] = slam->scan.hits[2u * k];
        slam->moved[2u * count + 1u] = slam->scan.hits[2u * k + 1u];
    }
    return count;
}

/* The parameters of the matches of this scan. Without wheel odometry a guess may be off by more than a wall is thick, and the
 * side of a wall that the scan is seen from is unknown. */
static ek_icp_parameters matcher_of(const ek_slam *slam)
{
    ek_icp_parameters matcher = slam->parameters.matcher;
    matcher.origin_x = slam->gate.measured ? slam->parameters.scan.base_from_sensor.x : (ek_real)NAN;
    matcher.origin_y = slam->parameters.scan.base_from_sensor.y;
    return matcher;
}

static void limit_iterations(ek_icp_parameters *parameters, int32_t most)
{
    parameters->max_iterations = parameters->max_iterations < most ? parameters->max_iterations : most;
}

/* Match points with a target, and note the work. */
static ek_status match_points(ek_slam *slam, const ek_index *target, const ek_real *xy, size_t count, ek_pose guess,
                              const ek_icp_parameters *parameters, ek_match *match)
{
    const ek_status status = ek_icp_register(&slam->icp, target, xy, count, guess, parameters, NULL, NULL, match);
    slam->matching += status == EK_OK ? ((uint64_t)match->iterations + 1u) * count : 0u;
    return status;
}

/* Match all points with near pairs, in few iterations. */
static ek_status match_all(ek_slam *slam, const ek_index *target, ek_pose guess, const ek_icp_parameters *parameters,
                           ek_match *match)
{
    ek_icp_parameters fine = *parameters;
    limit_iterations(&fine, FINE_ITERATIONS);
    fine.max_correspondence = slam->parameters.fine_correspondence;
    return match_points(slam, target, slam->scan.hits, slam->scan.count, guess, &fine, match);
}

/* Match a part of a large scan, then, unless the part suffices, all of it with near pairs: points beyond the end of the map
 * have none. Where the part suffices and has enough pairs, its share of pairs is taken for that of all points. */
static ek_status match_coarse_to_fine(ek_slam *slam, const ek_index *target, ek_pose guess,
                                      const ek_icp_parameters *parameters, int part_suffices, ek_match *match)
{
    const size_t count = take_part(slam, COARSE_POINTS);
    const int large = count < slam->scan.count;
    ek_icp_parameters coarse = *parameters;
    if (large) {
        limit_iterations(&coarse, PART_ITERATIONS);
    }
    ek_status status = match_points(slam, target, slam->moved, count, guess, &coarse, match);
    if (status == EK_OK && large && part_suffices) {
        const int enough = match->inliers >= slam->parameters.min_inliers;
        match->inliers = enough ? (int32_t)((uint64_t)match->inliers * slam->scan.count / count) : match->inliers;
    } else if (status == EK_OK && large) {
        status = match_all(slam, target, match->target_from_source, parameters, match);
    }
    return status;
}

/* The pose, of short matches of a part of the scan from several headings at `centre` and from `also` (NULL: none), that
 * lies best on the target. */
static ek_pose try_starts(ek_slam *slam, const ek_index *target, ek_pose centre, const ek_pose *also, int closely,
                          ek_icp_parameters parameters)
{
    const size_t count = take_part(slam, TRIED_POINTS), turns = sizeof TURNS / sizeof TURNS[0];
    ek_real most = EK_R(0.0);
    ek_pose best = centre;
    limit_iterations(&parameters, PART_ITERATIONS);
    for (size_t k = 0; k < turns + (also ? 1u : 0u); k++) {
        const ek_pose turn = {EK_R(0.0), EK_R(0.0), k < turns ? TURNS[k] * EK_PI / EK_R(180.0) : EK_R(0.0)};
        const ek_pose start = k < turns ? ek_se2_compose(centre, turn) : *also;
        ek_match match;
        match_points(slam, target, slam->moved, count, start, &parameters,
                     &match); /* of the same points at the same place as before: no error */
        const ek_real on = rate(target, slam->moved, count, match.target_from_source, closely);
        if (on > most && is_close(centre, match.target_from_source)) {
            best = match.target_from_source;
            most = on;
        }
    }
    return best;
}

/* Set a match aside for another one that lies more closely on the target; see rate. */
static void take_closer(const ek_slam *slam, const ek_index *target, int closely, const ek_match *other, ek_match *match)
{
    const ek_real *const hits = slam->scan.hits;
    const size_t count = slam->scan.count;
    const ek_real on = rate(target, hits, count, other->target_from_source, closely);
    if (on > rate(target, hits, count, match->target_from_source, closely)) {
        *match = *other;
    }
}

/* Match the scan with the map from where a search finds it; 1 if that is clear: no other heading scores nearly as well, or the
 * match fits as usual. */
static int search_map(ek_slam *slam, const ek_index *target, ek_pose predicted, const ek_icp_parameters *narrow, ek_match *match)
{
    ek_pose start;
    int alone;
    if (!ek_slam_search(slam, slam->moved, take_part(slam, TRIED_POINTS), predicted, &start, &alone) ||
        match_coarse_to_fine(slam, target, start, narrow, 0, match) != EK_OK) {
        return 0;
    }
    return alone || (ek_slam_is_paired(match, slam->scan.count) && match->error <= EK_DOUBTFUL * slam->usual_error);
}

ek_status ek_slam_match(ek_slam *slam, const ek_index *target, ek_pose guess, const ek_pose *predicted, int part_suffices,
                        ek_match *match)
{
    ek_icp_parameters narrow = matcher_of(slam);
    const ek_status status = match_coarse_to_fine(slam, target, guess, &narrow, part_suffices, match);
    const int paired = ek_slam_is_paired(match, slam->scan.count), closely = predicted != NULL;
    const ek_real unusual = EK_UNUSUAL * slam->usual_error, most = unusual > EK_R(0.0) && unusual < POOR ? unusual : POOR;
    const int doubted = closely && (slam->tried || slam->usual_error > EK_R(0.0));
    const ek_real poor = doubted && EK_DOUBTFUL * slam->usual_error < most ? EK_DOUBTFUL * slam->usual_error : most;
    if (status != EK_OK || target->count == 0u || (paired && !(match->error > poor)) || (slam->tried && !closely)) {
        return status;
    }
    const ek_pose *const also = closely && slam->tried ? &guess : NULL;
    const ek_pose centre = also ? *predicted : guess;
    slam->tried = 1;
    narrow.max_correspondence = slam->parameters.fine_correspondence;
    ek_match other;
    if (closely && search_map(slam, target, *predicted, &narrow, &other)) {
        take_closer(slam, target, closely, &other, match);
        return EK_OK;
    }
    const ek_pose start = try_starts(slam, target, centre, also, closely, narrow);
    match_coarse_to_fine(slam, target, start, &narrow, part_suffices, &other);
    if (is_close(centre, other.target_from_source)) {
        take_closer(slam, target, closely, &other, match);
    }
    return EK_OK;
}

void ek_slam_observe(ek_slam *slam)
{
    if (!slam->observed) {
        ek_work work = ek_work_make(INT64_MAX);
        ek_observer_take(&slam->observer, &slam->thinner, slam->scan.hits, slam->scan.count, &work);
        slam->observed = 1;
    }
}

ek_pose ek_slam_limit(ek_slam *slam, const ek_index *target, ek_pose answer, ek_pose guess)
{
    if (slam->closed) {
        return answer;
    }
    ek_slam_observe(slam);
    const ek_openness open =
        ek_observer_measure_on(&slam->observer, target, answer, slam->parameters.fine_correspondence);
    return ek_openness_limit(&open, answer, guess);
}

int ek_slam_match_directly(ek_slam *slam, ek_pose *pose, ek_match *match)
{
    ek_icp_parameters matcher = matcher_of(slam);
    const size_t count = slam->scan.count;
    matcher.epsilon = DIRECT_EPSILON;
    if (count == 0u || match_all(slam, &slam->map_index, *pose, &matcher, match) != EK_OK) {
        return 0;
    }
    const ek_pose limited = ek_slam_limit(slam, &slam->map_index, match->target_from_source, *pose);
    const int sure = match->inliers >= slam->parameters.min_inliers &&
                     ek_slam_accepts(&slam->gate, count, *pose, limited, match) && slam->gate.sure;
    *pose = sure ? limited : *pose;
    return sure;
}

/* The front of slam.h: scale of the wheels, matching of a scan with further tries, and the doubt about a match. */
#include "ek/smooth.h"
#include "slam_parts.h"

#define MEMORY EK_R(50.0)    /* m: path over which the scale is averaged */
#define PRIOR EK_R(1.0)      /* m: path at scale 1 that is assumed to have been driven before */
#define MAX_ERROR EK_R(0.1)  /* a motion whose length differs by a larger share does not count */
#define MIN_STEP EK_R(0.1)   /* m */
#define UNEVEN (EK_PI / EK_R(180.0)) /* rad: a turn within a sweep that differs more from that at the rate before is uneven */
#define RIGHT_SHARE EK_R(0.25) /* of that difference: over the turn, odometry and matches may differ by so much */
#define POOR EK_R(0.1)       /* m: a larger mean distance is doubted, */
#define UNUSUAL EK_R(4.0)    /* and one of more than so many times the usual one */
#define MIN_SHARE EK_R(0.8)  /* a smaller share of points in pairs is doubted too */
#define NEAR EK_R(0.15)      /* m: of several answers, the one with most points within it is taken, */
#define CLOSE EK_R(0.1)      /* m: or, on the map without odometry, the one that lies most closely on it, up to here */
#define COARSE_POINTS 200u   /* a scan of twice as many points or more is matched first with every n-th of them, */
#define FINE_ITERATIONS 5    /* then, with the map, with all; as every scan directly from good odometry */
#define DIRECT_EPSILON EK_R(1e-4) /* m: of the stop rule there */
#define TRIED_POINTS 100u    /* the same for the further tries: the best of them is matched to the end */
#define PART_ITERATIONS 20   /* with a part of a scan */
#define FARTHEST EK_R(0.5)   /* m, and 36 deg: a further try that ends farther from the guess does not count */
#define FARTHEST_THETA (EK_R(36.0) * EK_PI / EK_R(180.0))

#define UNLIKELY EK_R(20.0)  /* times the usual gap to the odometry: a match farther from its guess by odometry is not accepted, */
#define NEAREST EK_R(0.3)    /* m, and 20 deg, and STEP_SHARE of the step: nearer than this it is, beyond FARTHEST it is not, */
#define NEAREST_THETA (EK_R(20.0) * EK_PI / EK_R(180.0))
#define STEP_SHARE EK_R(0.25)
#define POOR_SHARE EK_R(0.5) /* its limits are multiplied by this where a match has UNUSUAL times the usual error and pairs for less than MIN_SHARE */
#define CLEAR EK_R(0.04)     /* m: unless it has converged to a smaller error with CLEAR_SHARE of the points in pairs */
#define CLEAR_SHARE EK_R(0.9)
#define USUAL_COUNT 50u      /* scans over which the usual error of matches, and gap to the odometry, are averaged */
#define USUAL_SCANS EK_R(50.0)
#define DOUBTED EK_R(2.0)    /* times the usual error: beyond it a match is doubted, beyond twice that wholly */
#define APART EK_R(3.0)      /* the same for its gap to the odometry, in times the usual gap */
#define FIRST_GAP EK_R(0.01) /* m: odometry is thought to be no better than this, */
#define GAP_SHARE EK_R(0.05) /* and this share of its step, */
#define FIRST_TURN EK_R(0.01) /* rad: nor in heading */
#define FEWEST EK_R(40.0)    /* a match of a scan with fewer points is not accepted where the odometry is good enough for less than FARTHEST; */
#define TIMES_FEWER EK_R(3.0) /* of a lidar with few beams, of one with so many times fewer than usual */

static const ek_real TURNS[] = {EK_R(0.0), EK_R(-12.0), EK_R(12.0), EK_R(-24.0), EK_R(24.0)}; /* deg: of further tries */

void ek_slam_start_wheels(ek_slam *slam)
{
    slam->wheels.matched = slam->wheels.driven = PRIOR;
}

static ek_pose scaled(ek_pose motion, ek_real scale)
{
    motion.x *= scale;
    motion.y *= scale;
    return motion;
}

int64_t ek_slam_period_ns(const ek_slam *slam, const ek_sweep *sweep)
{
    const int64_t before_ns = slam->motion.interval_ns[0];
    const uint64_t elapsed_ns = (uint64_t)sweep->stamp_ns - (uint64_t)slam->motion.stamp_ns;
    return slam->motion.started && elapsed_ns < (uint64_t)before_ns ? (int64_t)elapsed_ns : before_ns;
}

ek_sweep ek_slam_prepare(ek_slam *slam, const ek_sweep *sweep, ek_noted *noted)
{
    const ek_real scale = slam->wheels.matched / slam->wheels.driven;
    ek_wheels *const wheels = &noted->wheels;
    ek_sweep prepared = *sweep;
    *wheels = slam->wheels;
    noted->dirt = slam->dirt;
    noted->noise = slam->noise;
    noted->company = slam->company;
    wheels->has_last = sweep->has_odometry;
    wheels->now = sweep->odom_from_base;
    if (sweep->has_odometry) {
        const ek_pose step = ek_se2_between(slam->wheels.last, sweep->odom_from_base);
        wheels->scaled = slam->wheels.has_last ? ek_se2_compose(slam->wheels.scaled, scaled(step, scale))
                                               : sweep->odom_from_base;
        wheels->last = sweep->odom_from_base;
        prepared.odom_from_base = wheels->scaled;
        prepared.start_from_end = scaled(sweep->start_from_end, scale);
    }
    if (sweep->ranges && sweep->angles && sweep->beams <= slam->parameters.points) {
        const ek_scan_parameters *const limits = &slam->parameters.scan;
        EK_COUNT(EK_PREPARED, sweep->beams);
        const int smoothed = ek_smooth_ranges(sweep->ranges, sweep->angles, sweep->beams, slam->cleaned);
        ek_range_noise_observe(&noted->noise, smoothed);
        ek_drop_speckles(smoothed ? slam->cleaned : sweep->ranges, sweep->angles, sweep->beams, limits->range_min,
                         limits->range_max, &noted->dirt, slam->cleaned);
        prepared.ranges = slam->cleaned;
        if (slam->parameters.use_odometry && sweep->has_odometry) {
            ek_drop_companions(slam->views, &noted->company, slam->cleaned, sweep->angles, sweep->beams, limits->range_min,
                               limits->range_max, ek_se2_compose(wheels->scaled, limits->base_from_sensor));
        } else {
            noted->company.older = noted->company.newer = 0u;
        }
    }
    return prepared;
}

void ek_slam_observe_wheels(ek_slam *slam, ek_pose matched, const ek_openness *open, int known)
{
    ek_wheels *const wheels = &slam->wheels;
    const int seen = ek_openness_is_closed(open), both = seen && wheels->seen;
    if (known && both && wheels->has_last && wheels->has_keyframe) {
        const ek_pose motion = ek_se2_between(wheels->keyframe, wheels->now);
        const ek_real driven = EK_SQRT(motion.x * motion.x + motion.y * motion.y);
        const ek_real along = (matched.x * motion.x + matched.y * motion.y) / (driven > EK_R(0.0) ? driven : EK_R(1.0));
        if (driven >= MIN_STEP && EK_FABS(along - driven) <= MAX_ERROR * driven) {
            wheels->matched += along;
            wheels->driven += driven;
            if (wheels->driven > MEMORY) {
                wheels->matched *= MEMORY / wheels->driven;
                wheels->driven = MEMORY;
            }
        }
    }
    wheels->seen = seen;
    wheels->has_keyframe = wheels->has_last;
    wheels->keyframe = wheels->now;
}

ek_real ek_slam_unevenness(const ek_slam *slam, const ek_sweep *sweep)
{
    const ek_real sweep_ns = (ek_real)sweep->time_increment_ns * (ek_real)(sweep->beams - 1u);
    const ek_real since_ns = (ek_real)((uint64_t)sweep->stamp_ns - (uint64_t)slam->motion.stamp_ns);
    const ek_real turn = ek_se2_between(slam->motion.odom_from_base, sweep->odom_from_base).theta;
    const ek_real by = EK_FABS(sweep->start_from_end.theta - turn * sweep_ns / since_ns);
    const int measured = slam->motion.has_last_odometry && sweep->has_odometry && sweep->has_motion;
    const int bends = slam->parameters.deskew && sweep_ns > EK_R(0.0) && by > UNEVEN;
    return measured && bends && !(slam->uneven.by > EK_R(0.0)) ? by : EK_R(0.0);
}

void ek_slam_note_turn(ek_slam *slam, const ek_prior *prior, ek_real by, const ek_slam_estimate *estimate)
{
    ek_uneven *const noted = &slam->uneven;
    const int matched = estimate->scan_to_map_accepted && !estimate->lost && !estimate->set_aside;
    if (noted->by > EK_R(0.0) && prior->has_odometry && matched) {
        const ek_real beyond = estimate->odom_from_base.theta - prior->odom_from_base.theta;
        const int right = EK_FABS(ek_se2_wrap(beyond - noted->beyond)) <= RIGHT_SHARE * noted->by;
        noted->right = !right ? 0 : noted->right < EK_TURNS_RIGHT ? noted->right + 1 : EK_TURNS_RIGHT;
    }
    noted->by = by;
    noted->beyond = slam->motion.start_from_base.theta - slam->motion.odom_from_base.theta;
}

/* 1 if enough of so many points have a pair. */
static int is_paired(const ek_match *match, size_t points)
{
    return (ek_real)match->inliers >= MIN_SHARE * (ek_real)points;
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
    return gap.x * gap.x + gap.y * gap.y <= FARTHEST * FARTHEST && EK_FABS(gap.theta) <= FARTHEST_THETA;
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
    return alone || (is_paired(match, slam->scan.count) && match->error <= DOUBTED * slam->usual_error);
}

ek_status ek_slam_match(ek_slam *slam, const ek_index *target, ek_pose guess, const ek_pose *predicted, int part_suffices,
                        ek_match *match)
{
    ek_icp_parameters narrow = matcher_of(slam);
    const ek_status status = match_coarse_to_fine(slam, target, guess, &narrow, part_suffices, match);
    const int paired = is_paired(match, slam->scan.count), closely = predicted != NULL;
    const ek_real unusual = UNUSUAL * slam->usual_error, most = unusual > EK_R(0.0) && unusual < POOR ? unusual : POOR;
    const int doubted = closely && (slam->tried || slam->usual_error > EK_R(0.0));
    const ek_real poor = doubted && DOUBTED * slam->usual_error < most ? DOUBTED * slam->usual_error : most;
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

/* So many times what is usual, between two limits. */
static ek_real limit_of(ek_real usual, ek_real least, ek_real most)
{
    const ek_real limit = UNLIKELY * usual > least ? UNLIKELY * usual : least;
    return limit < most ? limit : most;
}

/* The usual gap (m) to the odometry, which is thought to be no better than its step allows. */
static ek_real usual_gap_of(const ek_slam *slam, ek_pose step)
{
    const ek_real least = FIRST_GAP + GAP_SHARE * EK_SQRT(step.x * step.x + step.y * step.y);
    return slam->usual_gap > least ? slam->usual_gap : least;
}

ek_gate ek_slam_gate(const ek_slam *slam, int measured, ek_pose step)
{
    const ek_real fewest = slam->usual_points / TIMES_FEWER;
    ek_gate gate = {measured, FARTHEST, FARTHEST_THETA, UNUSUAL * slam->usual_error, fewest < FEWEST ? fewest : FEWEST,
                    DOUBTED * slam->usual_error, APART * usual_gap_of(slam, step), 0};
    if (slam->compared >= USUAL_COUNT) {
        const ek_real length = EK_SQRT(step.x * step.x + step.y * step.y), turn = EK_FABS(step.theta);
        gate.metres = limit_of(slam->usual_gap, NEAREST + STEP_SHARE * length, FARTHEST);
        gate.theta = limit_of(slam->usual_turn, NEAREST_THETA + STEP_SHARE * turn, FARTHEST_THETA);
    }
    return gate;
}

int ek_slam_is_good(const ek_gate *gate)
{
    return gate->measured && gate->metres < FARTHEST;
}

int ek_slam_accepts(ek_gate *gate, size_t points, ek_pose guess, ek_pose answer, const ek_match *match)
{
    const ek_pose gap = ek_se2_between(guess, answer);
    const ek_real squared = gap.x * gap.x + gap.y * gap.y;
    const int paired = is_paired(match, points);
    const int poor = !paired && gate->poor > EK_R(0.0) && match->error > gate->poor;
    const ek_real share = poor ? POOR_SHARE : EK_R(1.0), metres = share * gate->metres, theta = share * gate->theta;
    const int far = squared > metres * metres || EK_FABS(gap.theta) > theta;
    const int doubted = !paired || (gate->doubted > EK_R(0.0) && match->error > gate->doubted);
    const int apart = squared > gate->near * gate->near, strays = gate->sure && doubted && apart;
    const int clear = match->converged && match->error < CLEAR &&
                      (ek_real)match->inliers >= CLEAR_SHARE * (ek_real)points;
    const int few = ek_slam_is_good(gate) && (ek_real)points < gate->fewest;
    const int accepted = !gate->measured || (!few && (clear || !(far || strays)));
    gate->sure = ek_slam_is_good(gate) && accepted && !doubted && !apart;
    return accepted;
}

/* 0 up to a limit, 1 from twice the limit on, and between them in proportion. */
static ek_real share_over(ek_real value, ek_real limit)
{
    const ek_real over = limit > EK_R(0.0) ? value / limit - EK_R(1.0) : EK_R(0.0);
    return over > EK_R(1.0) ? EK_R(1.0) : over > EK_R(0.0) ? over : EK_R(0.0);
}

/* Move a recent mean towards a value, of which at most `most` counts. */
static ek_real take_mean(ek_real mean, ek_real value, ek_real most)
{
    return mean + ((value < most ? value : most) - mean) / USUAL_SCANS;
}

/* How much a match is doubted, 0 to 1, because it fits poorly. */
static ek_real misfit_of(const ek_slam *slam, const ek_match *match, ek_real usual)
{
    return is_paired(match, slam->scan.count) ? share_over(match->error, DOUBTED * usual) : EK_R(1.0);
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

int ek_slam_doubt(ek_slam *slam, const ek_pose *predicted, ek_pose matched, const ek_match *match)
{
    const ek_real usual = slam->usual_error > EK_R(0.0) ? slam->usual_error : match->error;
    const ek_real share = misfit_of(slam, match, usual);
    slam->usual_error = take_mean(usual, match->error, DOUBTED * usual);
    const ek_real more = (ek_real)slam->scan.count - slam->usual_points;
    slam->usual_points += slam->usual_points > EK_R(0.0) ? more / USUAL_SCANS : more;
    const int fits = share == EK_R(0.0);
    if (!predicted) {
        return fits;
    }
    const ek_pose gap = ek_se2_between(*predicted, matched);
    const ek_real squared = gap.x * gap.x + gap.y * gap.y, metres = EK_SQRT(squared);
    const ek_real usual_gap = usual_gap_of(slam, ek_se2_between(slam->motion.start_from_base, *predicted));
    const ek_real over = share_over(metres, APART * usual_gap), apart = over > share ? over : share;
    const ek_real turn = slam->usual_turn > FIRST_TURN ? slam->usual_turn : FIRST_TURN;
    slam->usual_gap = take_mean(slam->usual_gap, metres, EK_R(2.0) * usual_gap);
    slam->usual_turn = take_mean(slam->usual_turn, EK_FABS(gap.theta), EK_R(2.0) * turn);
    slam->compared += slam->compared < USUAL_COUNT;
    slam->doubt.position += apart * apart * squared;
    slam->doubt.heading += share * share * gap.theta * gap.theta;
    return fits;
}

/* The settings of loop_finder.h, and its verdict on the measured motion. */
#include "loop_parts.h"

#define CORRELATED EK_R(10.0)  /* points near each other have the same error: so many count as one */
#define CLEAR_RATIO EK_R(0.3)  /* from this ratio on the position along a corridor is as good as across */
#define OPEN_SIGMA EK_R(0.15)  /* m */
#define MIN_ERROR EK_R(0.01)   /* m */
#define POINT_WORK 20u
#define PART EK_R(0.75)            /* share of the score and the overlap that is enough for maps that lie on each other in part, */
#define PART_DEGENERATE EK_R(0.5)  /* and of the largest 1-sigma error that is then allowed */
#define PART_VARIANCE EK_R(15.0)   /* and the further variance of such a match, as a multiple of FLOOR */

static const ek_sym3 FLOOR = {EK_R(0.015) * EK_R(0.015), EK_R(0.0), EK_R(0.0), EK_R(0.015) * EK_R(0.015), EK_R(0.0),
                              EK_R(0.004) * EK_R(0.004)};

ek_loop_settings ek_loop_default(void)
{
    ek_loop_settings settings;
    settings.path = EK_R(15.0);
    settings.spacing = EK_R(1.0);
    settings.radius = EK_R(7.0);
    settings.submap = EK_R(3.0);
    settings.cell = EK_R(0.1);
    settings.score = EK_R(0.55);
    settings.ambiguity = EK_R(0.92);
    settings.near = EK_R(0.15);
    settings.overlap = EK_R(0.7);
    settings.in_view = EK_R(0.95);
    settings.degenerate = EK_R(0.13);
    settings.gate = EK_R(11.345);
    settings.quick_gate = EK_R(6.25);
    return settings;
}

ek_status ek_loop_check(const ek_loop_settings *settings)
{
    if (!settings) {
        return EK_NULL_POINTER;
    }
    const ek_real all[] = {settings->path,      settings->spacing, settings->radius,  settings->submap,
                           settings->cell,      settings->score,   settings->ambiguity, settings->near,
                           settings->overlap,   settings->in_view, settings->degenerate, settings->gate,
                           settings->quick_gate};
    for (size_t k = 0; k < sizeof all / sizeof *all; k++) {
        if (!isfinite(all[k])) {
            return EK_NOT_FINITE;
        }
        if (all[k] < EK_R(0.0) || all[k] > EK_R(1e6)) {
            return EK_OUT_OF_RANGE;
        }
    }
    const int shares = settings->score <= EK_R(1.0) && settings->ambiguity <= EK_R(1.0) && settings->overlap <= EK_R(1.0) &&
                       settings->in_view <= EK_R(1.0);
    const int window = settings->cell >= EK_R(0.02) && settings->cell <= EK_R(1.0) &&
                       settings->radius <= (ek_real)EK_SEARCH_MAX_HALF * settings->cell;
    return shares && window && settings->near > EK_R(0.0) ? EK_OK : EK_OUT_OF_RANGE;
}

/* Squared Mahalanobis distance of a motion from the predicted one. */
static ek_real chi_square(const ek_loop_finder *finder, ek_pose motion, const ek_sym3 *covariance)
{
    const ek_pose gap = ek_se2_between(motion, finder->motion);
    const ek_real residual[3] = {gap.x, gap.y, gap.theta};
    ek_sym3 information;
    return ek_sym3_inverse(covariance, &information) ? ek_sym3_quadratic(&information, residual) : (ek_real)INFINITY;
}

int ek_loop_is_possible(const ek_loop_finder *finder, ek_pose motion)
{
    const ek_real cell = finder->settings.cell * finder->settings.cell;
    const ek_sym3 rounding = {cell, EK_R(0.0), EK_R(0.0), cell, EK_R(0.0), EK_R(1e-4)};
    ek_sym3 covariance = ek_sym3_sum(&finder->covariance, &FLOOR, EK_R(1.0));
    covariance = ek_sym3_sum(&covariance, &rounding, EK_R(1.0));
    return chi_square(finder, motion, &covariance) <= EK_R(2.0) * finder->settings.gate;
}

ek_real ek_loop_part(const ek_loop_finder *finder)
{
    return finder->candidate.known && !finder->apart ? PART : EK_R(1.0);
}

/* Sum up the information of a point-to-line fit in the source's frame; the points on the map go to `raw`, in the source's
 * frame, and the others behind them, in that of the target. */
static ek_sym3 add_points(ek_loop_finder *finder)
{
    ek_sym3 sum = {EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    const ek_pose motion = finder->match;
    const ek_real c = EK_COS(motion.theta), s = EK_SIN(motion.theta), near = finder->settings.near;
    ek_real *missing = finder->raw + 2u * finder->source_count;
    finder->on_map = 0u;
    for (size_t k = 0; k < finder->source_count; k++) {
        const ek_real x = finder->source[2u * k], y = finder->source[2u * k + 1u];
        const ek_real there_x = c * x - s * y + motion.x, there_y = s * x + c * y + motion.y;
        const ek_neighbour found = ek_index_nearest(&finder->index, there_x, there_y, near, near);
        if (found.slot == EK_NONE) {
            missing -= 2;
            missing[0] = there_x;
            missing[1] = there_y;
            continue;
        }
        const ek_real *const normal = finder->normals + 2u * (size_t)finder->index.id[found.slot];
        const ek_real u = c * normal[0] + s * normal[1], v = c * normal[1] - s * normal[0], turn = x * v - y * u;
        const ek_sym3 more = {u * u, u * v, u * turn, v * v, v * turn, turn * turn};
        sum = ek_sym3_sum(&sum, &more, EK_R(1.0));
        finder->raw[2u * finder->on_map] = x;
        finder->raw[2u * finder->on_map++ + 1u] = y;
    }
    finder->missing = finder->source_count - finder->on_map;
    return sum;
}

/* Covariance of the match: of the fit, at least FLOOR, and more along an open direction. */
static ek_sym3 match_covariance(ek_loop_finder *finder, const ek_sym3 *sum, ek_work *work)
{
    const ek_sym3 weak = {EK_R(1e-4), EK_R(0.0), EK_R(0.0), EK_R(1e-4), EK_R(0.0), EK_R(1e-2)};
    const ek_real error = finder->match_error > MIN_ERROR ? finder->match_error : MIN_ERROR;
    const ek_sym3 information = ek_sym3_sum(&weak, sum, EK_R(1.0) / (CORRELATED * error * error));
    ek_sym3 covariance = FLOOR;
    ek_sym3_inverse(&information, &covariance);
    covariance = ek_sym3_sum(&covariance, &FLOOR, EK_R(1.0));
    ek_observer_take(&finder->observer, &finder->thinner, finder->raw, finder->on_map, work);
    const ek_openness open = ek_observer_measure(&finder->observer, EK_R(2.0) * EK_MAX_COORDINATE);
    const ek_real share = EK_R(1.0) - open.ratio / CLEAR_RATIO, sigma = OPEN_SIGMA * (share > EK_R(0.0) ? share : EK_R(0.0));
    const ek_sym3 along = {open.x * open.x, open.x * open.y, EK_R(0.0), open.y * open.y, EK_R(0.0), EK_R(0.0)};
    return ek_sym3_sum(&covariance, &along, sigma * sigma);
}

void ek_loop_judge(ek_loop_finder *finder, ek_work *work)
{
    const ek_loop_settings *const settings = &finder->settings;
    ek_loop_candidate *const candidate = &finder->candidate;
    const ek_sym3 sum = add_points(finder);
    const ek_real overlap = (ek_real)finder->on_map / (ek_real)finder->source_count, part = ek_loop_part(finder);
    const int in_part = part < EK_R(1.0) && (finder->best_score <= settings->score || overlap < settings->overlap);
    ek_work_spend(work, POINT_WORK * (uint64_t)finder->source_count);
    finder->phase = EK_FINDER_IDLE;
    candidate->edge.first_from_second = finder->match;
    candidate->number[0] = overlap;
    candidate->number[1] = part * settings->overlap;
    candidate->outcome = EK_LOOP_OVERLAP;
    if (!(overlap >= candidate->number[1])) {
        return;
    }
    ek_sym3 covariance = match_covariance(finder, &sum, work);
    const ek_real mean = EK_R(0.5) * (covariance.xx + covariance.yy), half = EK_R(0.5) * (covariance.xx - covariance.yy);
    const ek_real loosest = EK_SQRT(mean + EK_SQRT(half * half + covariance.xy * covariance.xy));
    candidate->number[0] = loosest;
    candidate->number[1] = settings->degenerate * (in_part ? PART_DEGENERATE : EK_R(1.0));
    candidate->outcome = EK_LOOP_DEGENERATE;
    const int is_known = loosest <= candidate->number[1];
    covariance = ek_sym3_sum(&covariance, &FLOOR, in_part ? PART_VARIANCE : EK_R(0.0));
    if (!is_known || !ek_sym3_inverse(&covariance, &candidate->edge.information)) {
        return;
    }
    covariance = ek_sym3_sum(&covariance, &finder->covariance, EK_R(1.0));
    candidate->chi = chi_square(finder, finder->match, &covariance);
    candidate->number[0] = candidate->chi;
    candidate->outcome = candidate->chi <= settings->gate ? EK_LOOP_PASSED : EK_LOOP_CHI;
    candidate->number[1] = candidate->outcome == EK_LOOP_PASSED ? overlap : settings->gate;
    if (in_part && candidate->outcome == EK_LOOP_PASSED) {
        finder->phase = EK_FINDER_LOOK;
    }
}

void ek_loop_look(ek_loop_finder *finder, const ek_keyframes *keyframes, ek_work *work)
{
    const ek_pose *const pose = keyframes->graph.pose;
    ek_real *const missing = finder->raw + 2u * finder->on_map;
    for (; finder->gathered < finder->gather_end && work->left > 0; finder->gathered++) {
        const size_t from = keyframes->start[finder->gathered], count = keyframes->start[finder->gathered + 1u] - from;
        const ek_pose moved = ek_se2_between(pose[finder->candidate.edge.first], pose[finder->gathered]);
        const ek_real c = EK_COS(moved.theta), s = EK_SIN(moved.theta);
        const ek_real *const sensor = keyframes->sensor + 2u * finder->gathered;
        ek_sight_take(&finder->sight, keyframes->points + 2u * from, count, sensor[0], sensor[1]);
        size_t hidden = 0u;
        for (size_t k = 0; k < finder->missing; k++) {
            const ek_real px = missing[2u * k], py = missing[2u * k + 1u], dx = px - moved.x, dy = py - moved.y;
            missing[2u * hidden] = px;
            missing[2u * hidden + 1u] = py;
            hidden += !ek_sight_could_see(&finder->sight, c * dx + s * dy - sensor[0], c * dy - s * dx - sensor[1],
                                         finder->settings.near);
        }
        ek_work_spend(work, EK_SIGHT_WORK * (uint64_t)(count + finder->missing));
        finder->missing = hidden;
    }
    if (finder->gathered < finder->gather_end) {
        return;
    }
    const ek_real share = (ek_real)finder->on_map / (ek_real)(finder->source_count - finder->missing);
    if (!(share >= finder->settings.in_view)) {
        finder->candidate.outcome = EK_LOOP_CONTRADICTED;
        finder->candidate.number[0] = share;
        finder->candidate.number[1] = finder->settings.in_view;
    }
    finder->phase = EK_FINDER_IDLE;
}

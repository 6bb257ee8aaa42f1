#include "loop_parts.h"

#include <string.h>

#define SAMPLES 300u
#define SIGMAS EK_R(3.0)
#define DEGREE (EK_PI / EK_R(180.0))
#define MIN_WINDOW EK_R(0.3)               /* m */
#define MIN_TURN (EK_R(3.0) * DEGREE)
#define MAX_TURN (EK_R(30.0) * DEGREE)
#define LOCAL EK_R(0.75)                   /* m */
#define PEAK EK_R(0.5)                     /* m: motions closer than this to the best one are the same peak */
#define TARGET_CELL EK_R(0.05)
#define SOURCE_CELL EK_R(0.1)
#define MIN_POINTS 50u
#define NEIGHBOURS 8u
#define NORMAL_WORK 160u
#define RIVALS 5u
#define COARSE EK_R(2.0) /* after a lost track the cells have so many times the side */

ek_status ek_loop_finder_init(ek_loop_finder *finder, ek_arena *arena, const ek_loop_settings *settings,
                              const ek_icp_parameters *coarse, const ek_icp_parameters *fine, size_t points, size_t cells)
{
    if (!finder || !arena || !coarse || !fine) {
        return EK_NULL_POINTER;
    }
    ek_status status = ek_loop_check(settings);
    if (status != EK_OK) {
        return status;
    }
    memset(finder, 0, sizeof *finder);
    finder->settings = *settings;
    finder->coarse = *coarse;
    finder->fine = *fine;
    finder->capacity = points;
    status = ek_thinner_init(&finder->thinner, arena, points);
    status = status == EK_OK ? ek_index_init(&finder->index, arena, points, 4u * points) : status;
    status = status == EK_OK ? ek_icp_init(&finder->icp, arena, points, points) : status;
    status = status == EK_OK ? ek_icp_init_lines(&finder->icp, arena) : status;
    status = status == EK_OK ? ek_score_grid_init(&finder->grid, arena, cells) : status;
    status = status == EK_OK ? ek_search_init(&finder->search, arena, points) : status;
    status = status == EK_OK ? ek_observer_init(&finder->observer, arena, points) : status;
    ek_real **const clouds[] = {&finder->raw, &finder->target, &finder->source, &finder->sample, &finder->normals};
    for (size_t k = 0; status == EK_OK && k < sizeof clouds / sizeof *clouds; k++) {
        *clouds[k] = (ek_real *)ek_arena_alloc(arena, points, 2u * sizeof(ek_real));
    }
    return status;
}

/* Gather the points of the keyframes near one, in its frame, one keyframe in a part; 1: done. */
static int gather(ek_loop_finder *finder, const ek_keyframes *keyframes, uint32_t row, ek_work *work)
{
    const ek_pose *const pose = keyframes->graph.pose;
    for (; finder->gathered < finder->gather_end && work->left > 0; finder->gathered++) {
        const size_t from = keyframes->start[finder->gathered], to = keyframes->start[finder->gathered + 1u];
        const ek_pose moved = ek_se2_between(pose[row], pose[finder->gathered]);
        const ek_real c = EK_COS(moved.theta), s = EK_SIN(moved.theta);
        ek_real *into = finder->raw + 2u * finder->raw_count;
        for (size_t k = from; k < to; k++, into += 2) {
            const ek_real x = keyframes->points[2u * k], y = keyframes->points[2u * k + 1u];
            into[0] = c * x - s * y + moved.x;
            into[1] = s * x + c * y + moved.y;
        }
        finder->raw_count += to - from;
        ek_work_spend(work, to - from + 4u);
    }
    return finder->gathered == finder->gather_end;
}

/* Select the keyframes of the same part of the drive within a driven distance of one, as far as there is memory. */
static void select_near(ek_loop_finder *finder, const ek_keyframes *keyframes, size_t row, ek_real reach)
{
    size_t low = row, high = row + 1u;
    for (int grows = 1; grows;) {
        grows = 0;
        if (low > 0u && keyframes->section[low - 1u] == keyframes->section[row] &&
            keyframes->path[row] - keyframes->path[low - 1u] <= reach &&
            keyframes->start[high] - keyframes->start[low - 1u] <= finder->capacity) {
            low--;
            grows = 1;
        }
        if (high < keyframes->count && keyframes->section[high] == keyframes->section[row] &&
            keyframes->path[high] - keyframes->path[row] <= reach &&
            keyframes->start[high + 1u] - keyframes->start[low] <= finder->capacity) {
            high++;
            grows = 1;
        }
    }
    EK_COUNT(EK_OPERATIONS, high - low);
    finder->gathered = (uint32_t)low;
    finder->gather_end = keyframes->start[high] - keyframes->start[low] <= finder->capacity ? (uint32_t)high : (uint32_t)low;
    finder->raw_count = 0u;
}

static void judge_early(ek_loop_finder *finder, ek_loop_outcome outcome, ek_real number, ek_real other)
{
    finder->candidate.outcome = outcome;
    finder->candidate.number[0] = number;
    finder->candidate.number[1] = other;
    finder->phase = EK_FINDER_IDLE;
}

/* The search window: three sigma of what the graph predicts. */
static void fit_window(ek_loop_finder *finder)
{
    const ek_real c = EK_COS(finder->motion.theta), s = EK_SIN(finder->motion.theta);
    const ek_real turn[9] = {c, -s, EK_R(0.0), s, c, EK_R(0.0), EK_R(0.0), EK_R(0.0), EK_R(1.0)};
    const ek_sym3 there = ek_sym3_congruence(turn, &finder->covariance);
    const ek_real sigma[3] = {EK_SQRT(there.xx), EK_SQRT(there.yy), EK_SQRT(there.tt)};
    const ek_real low[3] = {MIN_WINDOW, MIN_WINDOW, MIN_TURN};
    const ek_real high[3] = {finder->settings.radius, finder->settings.radius, MAX_TURN};
    for (size_t k = 0; k < 3u; k++) {
        const ek_real half = SIGMAS * sigma[k] > low[k] ? SIGMAS * sigma[k] : low[k];
        finder->half[k] = half < high[k] ? half : high[k];
    }
    if (finder->turned) { /* places half a radius apart are searched one after the other */
        finder->half[0] = finder->half[1] = EK_R(0.5) * finder->settings.radius;
        finder->half[2] = EK_PI;
    }
    finder->candidate.is_local = finder->half[0] <= LOCAL && finder->half[1] <= LOCAL;
}

static void begin_search(ek_loop_finder *finder)
{
    const ek_search_window window = {finder->motion, finder->half[0], finder->half[1], finder->half[2]};
    const ek_search_prior prior = {finder->half[0] / SIGMAS, finder->half[1] / SIGMAS, finder->half[2] / SIGMAS};
    const size_t every = finder->source_count / SAMPLES > 1u ? finder->source_count / SAMPLES : 1u;
    finder->sample_count = 0u;
    for (size_t k = 0; k < finder->source_count; k += every, finder->sample_count++) {
        finder->sample[2u * finder->sample_count] = finder->source[2u * k];
        finder->sample[2u * finder->sample_count + 1u] = finder->source[2u * k + 1u];
    }
    ek_search_begin(&finder->search, &finder->grid, finder->sample, finder->sample_count, &window, &prior,
                    ek_loop_part(finder) * finder->settings.score);
    finder->phase = EK_FINDER_SEARCH;
}

/* Begin to search the next part of the window for another motion that fits nearly as well; 0: there is none left. */
static int begin_rival(ek_loop_finder *finder)
{
    static const ek_search_prior none = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    const ek_pose centre = finder->motion, best = finder->best;
    const ek_real left = centre.x - finder->half[0], right = centre.x + finder->half[0];
    const ek_real low = centre.y - finder->half[1], high = centre.y + finder->half[1];
    const ek_real inner = best.x - PEAK > left ? best.x - PEAK : left, outer = best.x + PEAK < right ? best.x + PEAK : right;
    const ek_real boxes[4][4] = {{left, best.x - PEAK, low, high},
                                 {best.x + PEAK, right, low, high},
                                 {inner, outer, low, best.y - PEAK},
                                 {inner, outer, best.y + PEAK, high}};
    for (; finder->rival < RIVALS; finder->rival++) {
        ek_search_window part = {best, PEAK, PEAK, EK_PI - EK_R(20.0) * DEGREE};
        if (finder->rival < 4u) {
            const ek_real *const box = boxes[finder->rival];
            part.centre.x = EK_R(0.5) * (box[0] + box[1]);
            part.centre.y = EK_R(0.5) * (box[2] + box[3]);
            part.centre.theta = centre.theta;
            part.x = EK_R(0.5) * (box[1] - box[0]);
            part.y = EK_R(0.5) * (box[3] - box[2]);
            part.theta = finder->half[2];
        } else {
            part.centre.theta = ek_se2_wrap(best.theta + EK_PI);
        }
        if ((finder->rival < 4u || !finder->candidate.known) && part.x > EK_R(0.0) && part.y > EK_R(0.0)) {
            ek_search_begin(&finder->search, &finder->grid, finder->sample, finder->sample_count, &part, &none,
                            finder->settings.ambiguity * finder->best_score);
            return 1;
        }
    }
    return 0;
}

static void predict(ek_loop_finder *finder, ek_keyframes *keyframes, ek_work *work)
{
    if (finder->candidate.known) {
        if (!ek_pose_graph_work(&keyframes->graph, work)) {
            return;
        }
        finder->covariance = keyframes->graph.solver.predicted;
    }
    select_near(finder, keyframes, finder->candidate.edge.first,
                finder->apart ? finder->settings.radius : finder->settings.submap);
    finder->phase = EK_FINDER_TARGET;
}

static void take_maps(ek_loop_finder *finder, ek_keyframes *keyframes, ek_work *work)
{
    const int target = finder->phase == EK_FINDER_TARGET;
    if (!gather(finder, keyframes, target ? finder->candidate.edge.first : finder->candidate.edge.second, work)) {
        return;
    }
    if (target) {
        finder->target_count = ek_thin(&finder->thinner, finder->raw, finder->raw_count, TARGET_CELL, finder->target, work);
        select_near(finder, keyframes, finder->candidate.edge.second, finder->settings.submap);
        finder->phase = EK_FINDER_SOURCE;
        return;
    }
    finder->source_count = ek_thin(&finder->thinner, finder->raw, finder->raw_count, SOURCE_CELL, finder->source, work);
    const size_t fewest = finder->source_count < finder->target_count ? finder->source_count : finder->target_count;
    if (fewest < MIN_POINTS) {
        judge_early(finder, EK_LOOP_FEW_POINTS, (ek_real)fewest, (ek_real)MIN_POINTS);
        return;
    }
    fit_window(finder);
    finder->phase = EK_FINDER_DRAW;
}

static void draw(ek_loop_finder *finder, ek_work *work)
{
    const ek_real cell = (finder->apart ? COARSE : EK_R(1.0)) * finder->settings.cell;
    ek_score_grid_draw(&finder->grid, &finder->thinner, finder->target, finder->target_count, cell, finder->motion.x,
                       finder->motion.y, finder->raw, work);
    finder->level = 1u;
    finder->phase = EK_FINDER_RAISE;
}

static void search(ek_loop_finder *finder, ek_work *work)
{
    if (!ek_search_work(&finder->search, work)) {
        return;
    }
    if (!finder->search.found) {
        judge_early(finder, EK_LOOP_SCORE, finder->search.left_out, ek_loop_part(finder) * finder->settings.score);
        return;
    }
    finder->best = finder->search.best;
    finder->best_score = finder->search.score;
    finder->rival = 0u;
    if (!finder->candidate.known) { /* another place that fits may be farther away than where this one was sought */
        finder->half[0] = finder->half[1] = finder->settings.radius;
        finder->half[2] = EK_PI;
    }
    finder->phase = begin_rival(finder) ? EK_FINDER_RIVAL : EK_FINDER_INDEX;
}

static void search_rival(ek_loop_finder *finder, ek_work *work)
{
    if (!ek_search_work(&finder->search, work)) {
        return;
    }
    if (finder->search.found && ek_loop_is_possible(finder, finder->search.best)) {
        judge_early(finder, EK_LOOP_AMBIGUOUS, finder->search.score / finder->best_score, finder->best_score);
        return;
    }
    finder->rival++;
    finder->phase = begin_rival(finder) ? EK_FINDER_RIVAL : EK_FINDER_INDEX;
}

static void index_target(ek_loop_finder *finder, ek_work *work)
{
    ek_index_build(&finder->index, finder->target, finder->target_count);
    ek_normals_compute(&finder->index, NEIGHBOURS, EK_FAR, finder->normals);
    finder->index.normals = finder->normals;
    ek_work_spend_tallied(work, NORMAL_WORK * (uint64_t)finder->target_count);
    finder->match = finder->best;
    finder->phase = EK_FINDER_COARSE;
}

static void match(ek_loop_finder *finder, ek_work *work)
{
    const int coarse = finder->phase == EK_FINDER_COARSE;
    ek_match found = {finder->match, 0, 0, 0, (ek_real)NAN, 0u};
    ek_icp_register(&finder->icp, &finder->index, finder->source, finder->source_count, finder->match,
                    coarse ? &finder->coarse : &finder->fine, NULL, NULL, &found);
    finder->match = found.target_from_source;
    finder->match_error = found.error;
    ek_work_spend_tallied(work, EK_MATCH_WORK * ((uint64_t)found.iterations + 1u) * finder->source_count);
    finder->phase = coarse ? EK_FINDER_FINE : EK_FINDER_JUDGE;
}

static void judge(ek_loop_finder *finder, const ek_keyframes *keyframes, ek_work *work)
{
    ek_loop_judge(finder, work);
    if (finder->phase == EK_FINDER_LOOK) { /* the normals and the samples are not needed any more */
        select_near(finder, keyframes, finder->candidate.edge.first, finder->settings.submap);
        finder->sight.ray = (ek_sight_ray *)finder->sample;
        finder->sight.other = (ek_sight_ray *)finder->normals;
    }
}

int ek_loop_finder_work(ek_loop_finder *finder, ek_keyframes *keyframes, ek_work *work)
{
    if (finder->phase == EK_FINDER_IDLE) {
        return 0;
    }
    while (finder->phase != EK_FINDER_IDLE && work->left > 0) {
        switch (finder->phase) {
        case EK_FINDER_PREDICT: predict(finder, keyframes, work); break;
        case EK_FINDER_TARGET:
        case EK_FINDER_SOURCE: take_maps(finder, keyframes, work); break;
        case EK_FINDER_DRAW: draw(finder, work); break;
        case EK_FINDER_RAISE:
            ek_score_grid_raise(&finder->grid, finder->level++, work);
            if (finder->level == EK_SCORE_LEVELS) {
                begin_search(finder);
            }
            break;
        case EK_FINDER_SEARCH: search(finder, work); break;
        case EK_FINDER_RIVAL: search_rival(finder, work); break;
        case EK_FINDER_INDEX: index_target(finder, work); break;
        case EK_FINDER_COARSE:
        case EK_FINDER_FINE: match(finder, work); break;
        case EK_FINDER_JUDGE: judge(finder, keyframes, work); break;
        default: ek_loop_look(finder, keyframes, work); break;
        }
    }
    return finder->phase == EK_FINDER_IDLE;
}

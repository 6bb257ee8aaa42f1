/* The search of slam.h: where on the map a doubted scan without odometry lies (wide_search.py). */
#include "slam_parts.h"

#define SIDE EK_R(0.8)  /* m, and TURN: the search goes so far from the prediction */
#define DEGREE (EK_PI / EK_R(180.0))
#define TURN (EK_R(60.0) * DEGREE)
#define CELL EK_R(0.1)  /* m */
#define SIGMAS EK_R(3.0)
#define RIVAL EK_R(0.92) /* share of the best score that no heading more than OTHER from the best one may reach */
#define OTHER (EK_R(20.0) * DEGREE)
#define TIMES 10         /* the work allowed to a scan */

/* Draw the scores of the map around a pose, once. */
static void draw_around(ek_slam *slam, ek_pose centre, ek_work *work)
{
    if (slam->around_drawn) {
        return;
    }
    ek_score_grid_draw(&slam->around, &slam->thinner, slam->map_points, slam->map_index.count, CELL, centre.x, centre.y,
                       slam->means, work);
    for (uint32_t level = 1u; level < EK_SCORE_LEVELS; level++) {
        ek_score_grid_raise(&slam->around, level, work);
    }
    slam->around_drawn = 1;
}

/* 1 unless a heading up to TURN from the prediction, and more than OTHER from the best one, has a score above `least`, or
 * the work does not suffice to tell. */
static int is_alone(ek_slam *slam, const ek_real *xy, size_t count, ek_pose centre, ek_real best, ek_real least, ek_work *work)
{
    static const ek_search_prior none = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    const ek_real offset = ek_se2_wrap(best - centre.theta);
    for (int side = -1; side <= 1; side += 2) {
        const ek_real from = offset + (ek_real)side * OTHER, to = (ek_real)side * TURN;
        const ek_pose middle = {centre.x, centre.y, centre.theta + EK_R(0.5) * (from + to)};
        const ek_search_window window = {middle, SIDE, SIDE, EK_R(0.5) * EK_FABS(to - from)};
        if ((to - from) * (ek_real)side > EK_R(0.0)) {
            ek_search_begin(&slam->search, &slam->around, xy, count, &window, &none, least);
            if (!ek_search_work(&slam->search, work) || slam->search.found) {
                return 0;
            }
        }
    }
    return 1;
}

int ek_slam_search(ek_slam *slam, const ek_real *xy, size_t count, ek_pose centre, ek_pose *best, int *alone)
{
    const ek_search_window window = {centre, SIDE, SIDE, TURN};
    const ek_search_prior prior = {SIDE / SIGMAS, SIDE / SIGMAS, TURN / SIGMAS};
    const int64_t allowed = ek_slam_allowed_work(slam);
    ek_work work = ek_work_make(allowed < INT64_MAX / TIMES ? TIMES * allowed : INT64_MAX);
    draw_around(slam, centre, &work);
    ek_search_begin(&slam->search, &slam->around, xy, count, &window, &prior, EK_R(0.0));
    const int found = ek_search_work(&slam->search, &work) && slam->search.found;
    if (found) {
        *best = slam->search.best;
        *alone = is_alone(slam, xy, count, centre, best->theta, RIVAL * slam->search.score, &work);
    }
    slam->matching += work.done / EK_MATCH_WORK;
    return found;
}

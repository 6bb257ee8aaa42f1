/* The parts of a drive, each by hand: open directions, lost tracks, keyframes, constant velocity, the lasting map. */
#include "check.h"
#include "ek/continuity.h"
#include "ek/keyframes.h"
#include "ek/motion.h"
#include "ek/observability.h"
#include "ek/voxel_map.h"

#define POINTS 400u
#define ALL (EK_R(2.0) * EK_MAX_COORDINATE)

static ek_thinner thinner;
static ek_observer observer;
static ek_continuity continuity;
static ek_index map;
static ek_keyframes keyframes;
static ek_scan scan;
static ek_real xy[2u * POINTS];
static ek_work work;

static const ek_pose ORIGIN = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};

static ek_pose pose_of(double x, double y, double theta)
{
    const ek_pose pose = {EK_R(x), EK_R(y), EK_R(theta)};
    return pose;
}

/* Two walls 3 m apart along a direction. */
static size_t corridor(double angle)
{
    for (size_t k = 0; k < 160u; k++) {
        const double along = 0.1 * (double)(k / 2u) - 4.0, across = k % 2u ? 1.5 : -1.5;
        xy[2u * k] = EK_R(cos(angle) * along - sin(angle) * across);
        xy[2u * k + 1u] = EK_R(sin(angle) * along + cos(angle) * across);
    }
    return 160u;
}

/* The four walls of a room of 2 `half` m, from `from` rad to `to` rad around its middle. */
static size_t room(double half, double from, double to, size_t count)
{
    for (size_t k = 0; k < count; k++) {
        const double angle = from + (to - from) * ((double)k + 0.5) / (double)count, c = cos(angle), s = sin(angle);
        const double range = half / (fabs(c) > fabs(s) ? fabs(c) : fabs(s));
        xy[2u * k] = EK_R(range * c);
        xy[2u * k + 1u] = EK_R(range * s);
    }
    return count;
}

static ek_openness measure(size_t count, ek_real reach)
{
    ek_observer_take(&observer, &thinner, xy, count, &work);
    return ek_observer_measure(&observer, reach);
}

static void what_lies_beyond_the_reach_fixes_nothing(void)
{
    size_t count = corridor(0.0); /* to 4 m, */
    for (size_t k = 0; k < 30u; k++, count++) { /* and a wall across its end */
        xy[2u * count] = EK_R(6.0);
        xy[2u * count + 1u] = EK_R(0.1) * (ek_real)k - EK_R(1.45);
    }
    const ek_openness seen = measure(count, EK_R(6.5));
    CHECK(seen.ratio > EK_R(0.1) && ek_openness_trust(&seen) >= EK_R(1.0));
    const ek_openness open = measure(count, EK_R(5.0));
    CHECK_NEAR(open.ratio, 0.0, 1e-4);
    CHECK_NEAR(fabs((double)open.x), 1.0, 1e-4);
    const ek_openness none = measure(count, EK_R(1.0));
    CHECK_NEAR(none.ratio, 0.0, 0.0); /* nothing is near: as seven points */
    CHECK_NEAR(none.x, 1.0, 0.0);
}

/* A corridor with a wall across its end, on a map without that wall. */
static void a_wall_that_is_not_on_the_map_fixes_nothing(void)
{
    static ek_real end[2u * 30u];
    const ek_pose pose = pose_of(0.3, -0.1, 0.5);
    const size_t count = corridor(0.0);
    for (size_t k = 0; k < 30u; k++) {
        end[2u * k] = EK_R(6.0);
        end[2u * k + 1u] = EK_R(0.1) * (ek_real)k - EK_R(1.45);
    }
    ek_real target[2u * POINTS];
    ek_se2_transform(pose, xy, count, target);
    CHECK(ek_index_build(&map, target, count) == EK_OK);
    memcpy(&xy[2u * count], end, sizeof end);
    ek_observer_take(&observer, &thinner, xy, count + 30u, &work);
    CHECK(ek_observer_measure(&observer, ALL).ratio > EK_R(0.1));
    const ek_openness open = ek_observer_measure_on(&observer, &map, pose, EK_R(0.3));
    CHECK_NEAR(open.ratio, 0.0, 1e-4);
    CHECK_NEAR(fabs((double)open.x), 1.0, 1e-4); /* in the scan's frame */
    CHECK(ek_observer_measure_on(&observer, &map, pose, EK_R(3.0)).ratio > EK_R(0.1)); /* 2.1 m from the walls' ends */
    CHECK_NEAR(ek_observer_measure_on(&observer, &map, pose_of(50.0, 0.0, 0.0), EK_R(0.3)).ratio, 0.0, 0.0); /* nowhere */
    CHECK(ek_index_build(&map, target, 0u) == EK_OK);
    CHECK_NEAR(ek_observer_measure_on(&observer, &map, pose, EK_R(0.3)).ratio, 0.0, 0.0);
}

static void a_corridor_is_open_along_its_walls(void)
{
    for (int k = 0; k < 4; k++) {
        const double angle = 0.5 * (double)EK_PI * k / 4.0;
        const ek_openness open = measure(corridor(angle), ALL);
        CHECK_NEAR(open.ratio, 0.0, 1e-4);
        CHECK_NEAR(fabs((double)open.x * cos(angle) + (double)open.y * sin(angle)), 1.0, 1e-4);
        CHECK(ek_openness_trust(&open) <= EK_R(0.0));
    }
    const ek_openness closed = measure(room(3.0, -3.14159, 3.14159, 400u), ALL);
    CHECK(closed.ratio > EK_R(0.8) && ek_openness_trust(&closed) >= EK_R(1.0));
    ek_work spent = ek_work_make(INT64_MAX);
    ek_observer_take(&observer, &thinner, xy, 400u, &spent);
    CHECK(spent.done > 8u * 400u + 20u * 200u + 160u * 100u && spent.done <= 200u * 400u); /* 240 cells of 24 m of wall, half of the normals */
    const ek_openness few = measure(7u, ALL);
    CHECK_NEAR(few.ratio, 0.0, 0.0); /* seven points say nothing: open, along x */
    CHECK_NEAR(few.x, 1.0, 0.0);
}

/* From 0.045 to 0.065 a match counts more and more along the open direction: a quarter, the half, all of it. */
static void a_match_counts_along_the_open_direction_by_what_the_walls_say(void)
{
    static const double ratios[] = {0.0, 0.045, 0.05, 0.055, 0.065, 1.0}, shares[] = {0.0, 0.0, 0.25, 0.5, 1.0, 1.0};
    const ek_pose match = pose_of(1.0, 2.0, 0.5 * (double)EK_PI), guess = pose_of(0.5, 0.4, 1.0);
    for (size_t k = 0; k < 6u; k++) {
        const ek_openness open = {.x = EK_R(1.0), .ratio = EK_R(ratios[k])}; /* ahead of the robot: the world's y */
        CHECK_NEAR(ek_openness_trust(&open), shares[k], 1e-5);
        const ek_pose limited = ek_openness_limit(&open, match, guess);
        CHECK_NEAR(limited.x, 1.0, 1e-6);
        CHECK_NEAR(limited.y, 0.4 + shares[k] * 1.6, 1e-4);
        CHECK_NEAR(limited.theta, match.theta, 0.0);
    }
}

/* A part of a circle about a place. */
static size_t circle(double x, double y, double radius, double part)
{
    for (size_t k = 0; k < 100u; k++) {
        const double angle = part * 2.0 * (double)EK_PI * (double)k / 100.0;
        xy[2u * k] = EK_R(x - radius * cos(angle));
        xy[2u * k + 1u] = EK_R(y - radius * sin(angle));
    }
    return 100u;
}

static void a_turn_in_a_round_room_or_about_a_pillar_is_open(void)
{
    for (size_t k = 0; k < 2u; k++) { /* all around; a quarter, which ends where normals are those of chords */
        const double x = k == 0u ? 0.5 : 1.5, y = k == 0u ? -0.3 : -0.8, tolerance = k == 0u ? 0.02 : 0.25;
        const size_t count = k == 0u ? circle(x, y, 2.0, 1.0) : circle(x, y, 1.2, 0.25);
        const ek_openness open = measure(count, ALL);
        CHECK_NEAR(open.open_turn, 1.0, 0.0);
        CHECK_NEAR(open.centre_x, x, tolerance);
        CHECK_NEAR(open.centre_y, y, tolerance);
        CHECK(ek_openness_trust(&open) >= EK_R(1.0) && !ek_openness_is_closed(&open));
    }
    const ek_openness walls = measure(room(3.0, -3.14159, 3.14159, 400u), ALL);
    CHECK_NEAR(walls.open_turn, 0.0, 0.0);
    CHECK(ek_openness_is_closed(&walls));
    const ek_openness corner = measure(room(3.0, 0.0, 1.5707, 200u), ALL);
    CHECK_NEAR(corner.open_turn, 0.0, 0.0);
    CHECK(ek_openness_is_closed(&corner));
}

/* A match that is a quarter turn more than the guess about a place: none, half and all of the turn is open. */
static void an_open_turn_is_left_to_the_guess(void)
{
    static const double shares[] = {0.0, 0.5, 1.0};
    const ek_pose match = pose_of(1.0, 2.0, 0.5 * (double)EK_PI), guess = pose_of(7.0, -3.0, 0.0);
    for (size_t k = 0; k < 3u; k++) {
        const double theta = 0.5 * (double)EK_PI * (1.0 - shares[k]);
        const ek_openness open = {.ratio = EK_R(1.0), .centre_x = EK_R(2.0), .open_turn = EK_R(shares[k])};
        const ek_pose limited = ek_openness_limit(&open, match, guess);
        CHECK_NEAR(limited.theta, theta, TOLERANCE);
        CHECK_NEAR(limited.x + 2.0 * cos(theta), 1.0, TOLERANCE); /* the place is where the match has it: at (1, 4) */
        CHECK_NEAR(limited.y + 2.0 * sin(theta), 4.0, TOLERANCE);
    }
    const ek_openness some = {.ratio = EK_R(1.0), .open_turn = EK_R(0.01)}, none = {.ratio = EK_R(1.0)};
    CHECK(!ek_openness_is_closed(&some) && ek_openness_is_closed(&none));
}

static int ask(size_t count, ek_pose pose, int has_odometry, const ek_index *known)
{
    return ek_continuity_is_lost(&continuity, &thinner, xy, count, pose, has_odometry, known, &work);
}

static int is_lost(size_t count, ek_pose pose, int has_odometry, const ek_index *known)
{
    const int lost = ask(count, pose, has_odometry, known);
    ek_continuity_keep(&continuity, &thinner, xy, count, pose, ORIGIN, &work);
    return lost;
}

static void a_scan_is_lost_where_it_contradicts_the_one_before(void)
{
    const ek_pose moved = pose_of(0.2, 0.0, 0.0), away = pose_of(0.9, 0.7, 0.0);
    for (int has_odometry = 0; has_odometry < 2; has_odometry++) {
        continuity.before.count = 0u;
        CHECK(!is_lost(room(3.0, -3.14159, 3.14159, 400u), ORIGIN, has_odometry, NULL)); /* the first one never is */
        CHECK(!is_lost(room(3.0, -3.14159, 3.14159, 400u), moved, has_odometry, NULL));  /* on the walls */
        CHECK(!is_lost(5u, away, has_odometry, NULL) && continuity.sight.rays > 100u);         /* too few: not even kept */
        for (size_t k = 0; k < 2u; k++) { /* the walls 0.9 and 0.7 m off; a scan that is not kept is not compared */
            const size_t count = room(3.0, -3.14159, 3.14159, 400u);
            CHECK(ask(count, away, has_odometry, NULL));
        }
        CHECK(is_lost(room(3.0, -3.14159, 3.14159, 400u), away, has_odometry, NULL));
        CHECK(!is_lost(room(3.0, -3.14159, 3.14159, 400u), away, has_odometry, NULL)); /* now it is */
    }
    /* on the map where the scan before was not: with odometry that is enough */
    for (int has_odometry = 0; has_odometry < 2; has_odometry++) {
        continuity.before.count = 0u;
        CHECK(!is_lost(room(3.0, -3.14159, 3.14159, 400u), ORIGIN, has_odometry, NULL));
        CHECK(ek_index_build(&map, xy, room(2.0, -3.14159, 3.14159, 400u)) == EK_OK);
        CHECK(is_lost(room(2.0, -3.14159, 3.14159, 400u), ORIGIN, has_odometry, &map) == !has_odometry);
    }
    CHECK(ek_index_build(&map, xy, room(6.0, -3.14159, 3.14159, 400u)) == EK_OK);
    CHECK(is_lost(room(1.2, -3.14159, 3.14159, 400u), ORIGIN, 1, &map)); /* neither on the scan nor on the map */
}

/* What the scan before could not see tells nothing: the track is lost without odometry, else the prediction is accepted. */
static void a_scan_of_other_places_is_accepted_with_odometry_only(void)
{
    static const double cases[3][3] = {{-1.4, 1.4, 3.0},     /* in front, then behind the robot */
                                       {-3.14159, 3.14159, 5.0}, /* then beyond the walls */
                                       {-3.14159, 3.14159, 3.0}};
    for (size_t k = 0; k < 3u; k++) {
        for (int has_odometry = 0; has_odometry < 2; has_odometry++) {
            continuity.before.count = 0u;
            CHECK(!is_lost(room(3.0, cases[k][0], cases[k][1], 300u), ORIGIN, has_odometry, NULL));
            const size_t count = k == 0u ? room(3.0, 1.74159, 4.54159, 300u) : room(cases[k][2], -3.14159, 3.14159, 400u);
            CHECK(is_lost(count, ORIGIN, has_odometry, NULL) == (k < 2u && !has_odometry));
        }
    }
}

/* The rays of a scan are sorted by bearing, whatever the order of its points and whatever lies behind them in memory. */
static void rays_are_sorted_by_bearing(void)
{
    for (size_t count = 20u; count < 40u; count++) {
        for (size_t k = 0; k < POINTS; k++) {
            continuity.sight.ray[k].bearing = continuity.sight.other[k].bearing = EK_R(-9.0);
        }
        for (size_t k = 0; k < count; k++) { /* on a circle of 3 m, in mixed order */
            const double angle = 2.0 * (double)EK_PI * (double)(k * 17u % 41u) / 41.0 - 3.0;
            xy[2u * k] = EK_R(3.0 * cos(angle));
            xy[2u * k + 1u] = EK_R(3.0 * sin(angle));
        }
        continuity.before.count = 0u;
        CHECK(!is_lost(count, ORIGIN, 0, NULL) && continuity.sight.rays == count);
        for (size_t k = 0; k < count; k++) {
            CHECK_NEAR(continuity.sight.ray[k].range, 3.0, 1e-5);
            CHECK(k == 0u || continuity.sight.ray[k].bearing > continuity.sight.ray[k - 1u].bearing);
        }
        CHECK(continuity.sight.ray[0].bearing >= -EK_PI);
    }
}

static ek_doubt doubt;

static ek_status add_step(double x, size_t points, ek_step_kind kind, double ratio)
{
    const ek_openness open = {.x = EK_R(0.6), .y = EK_R(0.8), .ratio = EK_R(ratio)};
    return ek_keyframes_add(&keyframes, xy, points, AT_BASE, pose_of(x, 0.0, 0.0), kind, &open, doubt, &work);
}

static ek_status add(double x, size_t points, int known, double ratio)
{
    return add_step(x, points, known ? EK_STEP_MATCHED : EK_STEP_UNKNOWN, ratio);
}

/* Steps of 1 m: a variance of 0.0004 m^2, and 20 times more along (0.6, 0.8) where the walls leave it open. */
static void the_information_of_a_step_follows_its_path_and_the_open_direction(void)
{
    static const double ratios[] = {0.3, 0.2, 0.1225, 0.045, 0.0}, shares[] = {0.0, 0.0, 0.5, 1.0, 1.0};
    CHECK(add(0.0, 3u, 1, 1.0) == EK_OK);
    for (size_t k = 0; k < 5u; k++) {
        CHECK(add(1.0, 2u, 1, ratios[k]) == EK_OK);
        ek_sym3 covariance;
        const ek_step *const step = keyframes.graph.step + k + 1u;
        const double variance = 0.0004, more = 20.0 * variance * shares[k];
        CHECK(ek_sym3_inverse(&step->information, &covariance));
        CHECK_NEAR((double)covariance.xx / (variance + 0.36 * more), 1.0, 1e-4);
        CHECK_NEAR((double)covariance.yy / (variance + 0.64 * more), 1.0, 1e-4);
        CHECK_NEAR((double)covariance.xy, 0.48 * more, 1e-6);
        CHECK_NEAR((double)covariance.tt / 0.000025, 1.0, 1e-4);
    }
    doubt.position = EK_R(0.01);
    doubt.heading = EK_R(0.001);
    CHECK(add(1.0, 2u, 1, 1.0) == EK_OK);
    doubt.position = doubt.heading = EK_R(0.0);
    const ek_sym3 *const doubted = &keyframes.graph.step[6].information; /* what is doubted is added to all directions */
    CHECK_NEAR((double)doubted->xx * 0.0104, 1.0, 1e-4);
    CHECK_NEAR((double)doubted->yy * 0.0104, 1.0, 1e-4);
    CHECK_NEAR((double)doubted->tt * 0.001025, 1.0, 1e-4);
    keyframes.count = keyframes.graph.count = 6u;
    CHECK_NEAR(keyframes.path[5], 5.0, TOLERANCE);
    CHECK_NEAR(keyframes.apart[0], 6.0, TOLERANCE);
    CHECK(keyframes.start[6] == 13u && keyframes.count == 6u);
}

/* A second part of the drive after a lost track: its distance is unknown until a loop joins it. */
static void a_loop_joins_what_a_lost_track_has_parted(void)
{
    const ek_sym3 unit = {EK_R(1.0), EK_R(0.0), EK_R(0.0), EK_R(1.0), EK_R(0.0), EK_R(1.0)};
    const ek_loop_edge loop = {1u, 7u, pose_of(0.0, 2.0, 0.5 * (double)EK_PI), unit, EK_R(1.0)};
    CHECK(add(9.0, 1u, 0, 1.0) == EK_OK && add(1.0, 1u, 1, 1.0) == EK_OK);
    CHECK(keyframes.section[5] == 0u && keyframes.section[6] == 1u && keyframes.section[7] == 1u);
    CHECK_NEAR(keyframes.graph.step[6].information.xx, 1e-4, 1e-9);
    for (size_t k = 0; k < 6u; k++) {
        CHECK(keyframes.apart[k] >= EK_APART);
    }
    CHECK_NEAR(keyframes.apart[6], 1.0, TOLERANCE);
    const uint64_t before = work.done;
    ek_keyframes_join(&keyframes, &loop, 1, &work); /* keyframe 7 to (1, 2), turned to the left; 6 is 1 m behind it */
    CHECK(work.done - before == 6u * 8u); /* the motion of a pose takes six operations */
    CHECK_NEAR(keyframes.graph.pose[7].x, 1.0, TOLERANCE);
    CHECK_NEAR(keyframes.graph.pose[7].y, 2.0, TOLERANCE);
    CHECK_NEAR(keyframes.graph.pose[7].theta, 0.5 * (double)EK_PI, TOLERANCE);
    CHECK_NEAR(keyframes.graph.pose[6].x, 1.0, TOLERANCE);
    CHECK_NEAR(keyframes.graph.pose[6].y, 1.0, TOLERANCE);
    CHECK_NEAR(keyframes.graph.pose[5].x, 5.0, TOLERANCE); /* the first part stays */
    CHECK(ek_pose_graph_close(&keyframes.graph, &loop) == EK_OK);
    ek_keyframes_measure(&keyframes, &work);
    static const double apart[] = {1.5, 0.5, 1.5, 2.5, 3.5, 4.5, 1.0, 0.0}; /* a loop adds half a metre */
    for (size_t k = 0; k < 8u; k++) {
        CHECK_NEAR(keyframes.apart[k], apart[k], 1e-6);
    }
}

/* A third part, by odometry alone: known to 0.5 m and 10 degrees, and unknown where a loop contradicts it. */
static void the_odometry_across_a_lost_track_is_doubted(void)
{
    const ek_sym3 unit = {EK_R(1.0), EK_R(0.0), EK_R(0.0), EK_R(1.0), EK_R(0.0), EK_R(1.0)};
    const ek_loop_edge loop = {1u, 8u, pose_of(0.0, -3.0, 0.0), unit, EK_R(1.0)};
    CHECK(add_step(1.0, 1u, EK_STEP_MEASURED, 1.0) == EK_OK);
    const ek_step *const step = keyframes.graph.step + 8;
    const double turn = 10.0 * (double)EK_PI / 180.0;
    CHECK_NEAR((double)step->information.xx * (0.25 + 0.0004), 1.0, 1e-4);
    CHECK_NEAR((double)step->information.tt * (turn * turn + 0.000025), 1.0, 1e-4);
    for (size_t k = 0; k < 8u; k++) {
        CHECK(keyframes.apart[k] >= EK_DOUBTED && keyframes.apart[k] < EK_APART);
    }
    ek_keyframes_measure(&keyframes, &work);
    CHECK(keyframes.apart[0] >= EK_DOUBTED && keyframes.apart[0] < EK_APART && keyframes.section[8] == 2u);
    const ek_pose seventh = keyframes.graph.pose[7];
    ek_keyframes_join(&keyframes, &loop, 0, &work);
    CHECK_NEAR(keyframes.graph.pose[8].x, 1.0, TOLERANCE);
    CHECK_NEAR(keyframes.graph.pose[8].y, -3.0, TOLERANCE);
    CHECK(memcmp(&seventh, keyframes.graph.pose + 7, sizeof seventh) == 0 && keyframes.kind[8] == EK_STEP_MEASURED);
    ek_keyframes_join(&keyframes, &loop, 1, &work);
    CHECK(keyframes.kind[8] == EK_STEP_UNKNOWN && keyframes.kind[7] == EK_STEP_MATCHED);
    CHECK_NEAR(step->information.xx, 1e-4, 1e-9);
    keyframes.count = keyframes.graph.count = 8u;
}

static void what_does_not_fit_is_refused_and_changes_nothing(void)
{
    const size_t count = keyframes.count, used = keyframes.start[count];
    CHECK(add(1e7, 1u, 1, 1.0) == EK_OUT_OF_RANGE && keyframes.count == count);
    CHECK(add(1.0, 40u - used + 1u, 1, 1.0) == EK_TOO_MANY_POINTS && keyframes.count == count);
    CHECK(add(1.0, 40u - used, 1, 1.0) == EK_OK && add(1.0, 0u, 1, 1.0) == EK_OK);
    CHECK(add(1.0, 0u, 1, 1.0) == EK_TOO_MANY_POINTS && keyframes.count == count + 2u);
}

/* A sweep of up to three beams that all end 2 m ahead. */
static ek_sweep sweep_of(size_t beams, int64_t time_increment_ns)
{
    static ek_real ranges[3] = {EK_R(2.0), EK_R(2.0), EK_R(2.0)}, angles[3] = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
    ek_sweep sweep;
    memset(&sweep, 0, sizeof sweep);
    sweep.ranges = ranges;
    sweep.angles = angles;
    sweep.beams = beams;
    sweep.time_increment_ns = time_increment_ns;
    return sweep;
}

/* 0.1 m in 100 ns: half of it in half the time, and never more than two steps of it. */
static void constant_velocity_is_extrapolated_for_two_steps_at_most(void)
{
    static const int64_t elapsed[] = {50, 100, 200, 300, INT64_MAX};
    static const double driven[] = {0.05, 0.1, 0.2, 0.2, 0.2};
    ek_motion motion;
    memset(&motion, 0, sizeof motion);
    CHECK_NEAR(ek_motion_extrapolate(&motion, 100).x, 0.0, 0.0);
    motion.step_ns = 100;
    motion.step = pose_of(0.1, 0.0, 0.0);
    for (size_t k = 0; k < 5u; k++) {
        CHECK_NEAR(ek_motion_extrapolate(&motion, elapsed[k]).x, driven[k], TOLERANCE);
    }
    const ek_scan_parameters parameters = {ORIGIN, EK_R(0.1), EK_R(10.0), EK_R(0.0)};
    ek_sweep sweep = sweep_of(3u, 50);
    CHECK(ek_motion_project(&motion, &scan, &sweep, &parameters, 1) == EK_OK);
    CHECK_NEAR(scan.hits[0], 2.0, TOLERANCE); /* the sensor is at 0, 0.05 and 0.1 m */
    CHECK_NEAR(scan.hits[2], 2.05, TOLERANCE);
    CHECK_NEAR(scan.hits[4], 2.1, TOLERANCE);
    CHECK(ek_motion_project(&motion, &scan, &sweep, &parameters, 0) == EK_OK);
    CHECK_NEAR(scan.hits[4], 2.0, TOLERANCE);
    sweep.time_increment_ns = INT64_MAX / 2 + 1; /* twice of it overflows */
    CHECK(ek_motion_project(&motion, &scan, &sweep, &parameters, 1) == EK_OUT_OF_RANGE);
    sweep.time_increment_ns = -1;
    CHECK(ek_motion_project(&motion, &scan, &sweep, &parameters, 1) == EK_OUT_OF_RANGE);
    sweep.beams = 1u; /* a single beam takes no time */
    sweep.time_increment_ns = INT64_MAX;
    CHECK(ek_motion_project(&motion, &scan, &sweep, &parameters, 1) == EK_OK);
    CHECK_NEAR(scan.hits[0], 2.0, TOLERANCE);
}

/* Sweeps of 100 ns without a pause, matched at 0, 0.3 and 0.5 m. Deskewed at 0, 0 and 0.3 m a sweep, their middles are at 0, 0.3
 * and 0.65 m, and their first beams half a step of 0.3 and 0.35 m before. Points are 0.15 and -0.025 m from there. */
static void the_pose_at_the_first_beam_is_found_from_the_middles_of_the_last_two_sweeps(void)
{
    static const double matched[] = {0.0, 0.3, 0.5}, first[] = {0.0, 0.15, 0.475}, within[] = {0.0, 0.3, 0.35};
    static const double predicted[] = {0.0, 0.15, 0.325};
    const ek_scan_parameters parameters = {ORIGIN, EK_R(0.1), EK_R(10.0), EK_R(0.0)};
    ek_sweep sweep = sweep_of(2u, 100);
    ek_motion motion;
    memset(&motion, 0, sizeof motion);
    for (size_t k = 0; k < 3u; k++) {
        const ek_prior prior = {(int64_t)(100u * k), 0, ORIGIN}, next = {(int64_t)(100u * k + 100u), 0, ORIGIN};
        CHECK(ek_motion_project(&motion, &scan, &sweep, &parameters, 1) == EK_OK);
        ek_motion_store(&motion, &prior, pose_of(matched[k], 0.0, 0.0));
        CHECK_NEAR(motion.start_from_base.x, first[k], TOLERANCE);
        CHECK_NEAR(motion.start_from_points.x, matched[k], TOLERANCE);
        CHECK_NEAR(ek_motion_predict(&motion, &next).x, predicted[k], TOLERANCE);
        CHECK(ek_motion_project(&motion, &scan, &sweep, &parameters, 1) == EK_OK);
        CHECK_NEAR(scan.hits[2], 2.0 + within[k], TOLERANCE);
    }
    const ek_prior before = {300, 1, pose_of(7.0, 0.0, 0.0)}, driven = {400, 1, pose_of(7.2, 0.0, 0.0)};
    ek_motion_store(&motion, &before, pose_of(1.0, 0.0, 0.0)); /* within it 0.35 m: the middle 0.525 m after the last one */
    CHECK_NEAR(motion.start_from_base.x, 1.175 - 0.2625, TOLERANCE);
    CHECK_NEAR(ek_motion_predict(&motion, &driven).x, 0.2 - 0.0875, TOLERANCE); /* wheels measure from the first beam */
    sweep.has_motion = 1;
    sweep.start_from_end = pose_of(0.4, 0.0, 0.0);
    CHECK(ek_motion_project(&motion, &scan, &sweep, &parameters, 1) == EK_OK);
    CHECK_NEAR(scan.hits[2], 2.4, TOLERANCE);
    ek_motion_store(&motion, &driven, pose_of(1.2, 0.0, 0.0)); /* measured within: as matched */
    CHECK_NEAR(motion.start_from_base.x, 1.2, TOLERANCE);
    CHECK(motion.step_ns == 50);
}

/* Sweeps of 100 ns, matched at 0 and 0.2 m. A third one 49 ns later tells no velocity, wherever it is matched: 0.2 m a sweep
 * stays, and the next velocity is measured from the second: 0.7 m, and half of 0.2 m on, in two sweeps. */
static void sweeps_less_than_half_a_sweep_apart_tell_no_velocity(void)
{
    static const double soon[] = {0.2, 0.4};
    const ek_scan_parameters parameters = {ORIGIN, EK_R(0.1), EK_R(10.0), EK_R(0.0)};
    const ek_sweep sweep = sweep_of(2u, 100);
    for (size_t k = 0; k < 2u; k++) {
        const int64_t stamps[] = {0, 100, 149, 300};
        const double matched[] = {0.0, 0.2, soon[k], 0.7}, step[] = {0.0, 0.2, 0.2, 0.6};
        ek_motion motion;
        memset(&motion, 0, sizeof motion);
        for (size_t at = 0; at < 4u; at++) {
            const ek_prior prior = {stamps[at], 0, ORIGIN};
            CHECK(ek_motion_project(&motion, &scan, &sweep, &parameters, 1) == EK_OK);
            ek_motion_store(&motion, &prior, pose_of(matched[at], 0.0, 0.0));
            CHECK_NEAR(motion.step.x, step[at], TOLERANCE);
            CHECK(motion.step_ns == (at == 3u ? 200 : at > 0u ? 100 : 0));
            CHECK(motion.stamp_ns == stamps[at]);
        }
    }
}

static void a_full_map_drops_new_voxels_and_a_full_voxel_new_points(void)
{
    const ek_real four[] = {EK_R(0.2), EK_R(0.2), EK_R(1.5), EK_R(0.5), EK_R(0.6), EK_R(0.4), EK_R(0.4), EK_R(0.3)};
    const ek_real later[] = {EK_R(0.9), EK_R(0.9), EK_R(2.5), EK_R(0.5)};
    ek_real moved[8], means[6];
    int32_t cells[8];
    uint32_t points[3];
    ek_voxel_map voxels;
    ek_arena arena = memory_of(4096u);
    CHECK(ek_voxel_map_init(&voxels, &arena, 2u, EK_R(1.0), 1u) == EK_OK && ek_arena_check(&arena) == EK_OK);
    ek_voxel_map_add(&voxels, four, 4u, NULL, pose_of(10.0, 0.0, 0.0), moved, cells, &work);
    CHECK(voxels.count == 2u && voxels.dropped == 0u);
    ek_voxel_map_add(&voxels, later, 2u, NULL, pose_of(10.0, 0.0, 0.0), moved, cells, &work);
    CHECK(voxels.count == 2u && voxels.dropped == 1u);
    CHECK(ek_voxel_map_cloud(&voxels, EK_R(10.0), EK_R(0.0), EK_R(5.0), means, points, NULL, 3u, &work) == 2u);
    CHECK_NEAR(means[0], 10.4, TOLERANCE); /* of all three points of the first cloud, and none of the second */
    CHECK_NEAR(means[1], 0.3, TOLERANCE);
    CHECK_NEAR(means[2], 11.5, TOLERANCE);
    CHECK(points[0] == 3u && points[1] == 1u);
    CHECK(ek_voxel_map_cloud(&voxels, EK_R(10.0), EK_R(0.0), EK_R(5.0), means, points, NULL, 1u, &work) == 1u);
    CHECK(ek_voxel_map_cloud(&voxels, EK_R(10.0), EK_R(0.0), EK_R(1.0), means, points, NULL, 3u, &work) == 1u);
    ek_voxel_map_clear(&voxels);
    CHECK(ek_voxel_map_cloud(&voxels, EK_R(10.0), EK_R(0.0), EK_R(5.0), means, points, NULL, 3u, &work) == 0u);
    free(arena.memory);
}

static void a_map_keeps_from_where_its_points_were_seen(void)
{
    const ek_real three[] = {EK_R(0.0), EK_R(2.0), EK_R(0.0), EK_R(-2.0), EK_R(3.0), EK_R(4.0)};
    const ek_real sensors[2][2] = {{EK_R(0.0), EK_R(0.0)}, {EK_R(3.0), EK_R(-2.0)}};
    static const double expected[] = {0.9, 0.3, -0.5, 0.5, 0.9, -0.3}; /* means of both, turned by 90 deg */
    ek_real moved[6], means[6], seen_from[6];
    int32_t cells[6];
    ek_voxel_map voxels;
    ek_arena arena = memory_of(4096u);
    ek_voxel_map_init(&voxels, &arena, 8u, EK_R(1.0), 9u);
    CHECK(ek_voxel_map_keep_views(&voxels, &arena) == EK_OK && ek_arena_check(&arena) == EK_OK);
    for (int k = 0; k < 2; k++) {
        work = ek_work_make(INT64_MAX);
        ek_voxel_map_add(&voxels, three, 3u, sensors[k], pose_of(0.5, 0.5, 1.5707963267948966), moved, cells, &work);
        CHECK(work.done == 24u);
    }
    CHECK(ek_voxel_map_cloud(&voxels, EK_R(0.0), EK_R(0.0), EK_R(9.0), means, NULL, seen_from, 3u, &work) == 3u);
    for (size_t k = 0; k < 6u; k++) {
        CHECK_NEAR(seen_from[k], expected[k], TOLERANCE);
    }
    free(arena.memory);
}

int main(void)
{
    const ek_drift drift = {EK_R(0.02), EK_R(0.005)};
    ek_arena arena = memory_of(2000000u);
    CHECK(ek_thinner_init(&thinner, &arena, POINTS) == EK_OK && ek_observer_init(&observer, &arena, POINTS) == EK_OK);
    CHECK(ek_continuity_init(&continuity, &arena, POINTS) == EK_OK && ek_index_init(&map, &arena, POINTS, 4000u) == EK_OK);
    CHECK(ek_keyframes_init(&keyframes, &arena, 10u, 40u, 2u, drift) == EK_OK && ek_scan_init(&scan, &arena, 3u) == EK_OK);
    CHECK(ek_arena_check(&arena) == EK_OK);
    work = ek_work_make(INT64_MAX);
    a_corridor_is_open_along_its_walls();
    what_lies_beyond_the_reach_fixes_nothing();
    a_wall_that_is_not_on_the_map_fixes_nothing();
    a_match_counts_along_the_open_direction_by_what_the_walls_say();
    a_turn_in_a_round_room_or_about_a_pillar_is_open();
    an_open_turn_is_left_to_the_guess();
    a_scan_is_lost_where_it_contradicts_the_one_before();
    a_scan_of_other_places_is_accepted_with_odometry_only();
    rays_are_sorted_by_bearing();
    the_information_of_a_step_follows_its_path_and_the_open_direction();
    a_loop_joins_what_a_lost_track_has_parted();
    the_odometry_across_a_lost_track_is_doubted();
    what_does_not_fit_is_refused_and_changes_nothing();
    constant_velocity_is_extrapolated_for_two_steps_at_most();
    the_pose_at_the_first_beam_is_found_from_the_middles_of_the_last_two_sweeps();
    sweeps_less_than_half_a_sweep_apart_tell_no_velocity();
    a_map_keeps_from_where_its_points_were_seen();
    a_full_map_drops_new_voxels_and_a_full_voxel_new_points();
    free(arena.memory);
    return verdict();
}

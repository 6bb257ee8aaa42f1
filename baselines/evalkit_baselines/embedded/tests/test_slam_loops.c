/* Decisions on loops, each on both sides of its bound: which agree, which wait, what is recorded, drawn and begun anew. */
#include "src/slam_loops.c"

#include "line.h"

static ek_loop_candidate candidate_of(ek_loop_edge edge, ek_loop_outcome outcome)
{
    ek_loop_candidate candidate;
    memset(&candidate, 0, sizeof candidate);
    candidate.edge = edge;
    candidate.outcome = outcome;
    candidate.chi = EK_R(1.0);
    candidate.known = 1;
    return candidate;
}

/* Two measurements of one place agree to 0.2 m and 2 degrees, over at most 6 m of path. */
static void candidates_agree_where_they_measure_one_place(void)
{
    const double turn = 2.0 * (double)EK_PI / 180.0;
    const struct {
        uint32_t second;
        double x, y, theta;
        int agrees;
    } cases[] = {{10u, 0.2, 0.0, 0.0, 1},         {10u, 0.0, -0.2, 0.0, 1},        {10u, 0.201, 0.0, 0.0, 0},
                 {10u, 0.0, 0.201, 0.0, 0},       {10u, 0.15, 0.15, 0.0, 0},       {10u, 0.13, 0.13, 0.0, 1},
                 {10u, 0.0, 0.0, 0.999 * turn, 1}, {10u, 0.0, 0.0, -0.999 * turn, 1}, {10u, 0.0, 0.0, 1.001 * turn, 0},
                 {10u, 0.0, 0.0, -1.001 * turn, 0}, {16u, 0.0, 0.0, 0.0, 1},         {17u, 0.0, 0.0, 0.0, 0}};
    ek_arena arena = line_of(20u);
    const ek_loop_edge first = edge_of(0u, 10u, ORIGIN, 1.0);
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        const double ahead = (double)cases[k].second - 10.0;
        const ek_pose motion = pose_of(ahead + cases[k].x, cases[k].y, cases[k].theta);
        const ek_loop_edge second = edge_of(0u, cases[k].second, motion, 1.0);
        CHECK(agree(&slam, &first, &second) == cases[k].agrees);
    }
    /* from keyframe 3, turned to the left: 2 m behind keyframe 10 is 5 m behind its own place */
    const ek_loop_edge turned = edge_of(3u, 12u, pose_of(-3.0, 2.0, 0.5 * (double)EK_PI), 1.0);
    const ek_loop_edge left = edge_of(0u, 10u, pose_of(0.0, 0.0, 0.5 * (double)EK_PI), 1.0);
    CHECK(agree(&slam, &left, &turned) && !agree(&slam, &first, &turned));
    free(arena.memory);
}

static void a_candidate_is_confirmed_by_itself_or_by_one_that_waits(void)
{
    static const double chis[] = {6.25, 6.26};
    ek_arena arena = line_of(20u);
    ek_loop_candidate candidate = candidate_of(edge_of(0u, 10u, ORIGIN, 1.0), EK_LOOP_PASSED);
    for (size_t k = 0; k < 4u; k++) {
        candidate.chi = EK_R(chis[k % 2u]);
        candidate.is_local = k < 2u;
        CHECK(is_confirmed(&slam, &candidate) == (k == 0u));
    }
    slam.waiting[0] = candidate_of(edge_of(0u, 9u, pose_of(5.0, 0.0, 0.0), 1.0), EK_LOOP_PASSED);
    slam.waiting[1] = candidate_of(edge_of(0u, 9u, pose_of(-1.0, 0.0, 0.0), 1.0), EK_LOOP_PASSED);
    slam.waiting[2] = slam.waiting[0];
    for (uint32_t count = 0; count < 4u; count++) {
        slam.waiting_count = count;
        CHECK(is_confirmed(&slam, &candidate) == (count >= 2u));
    }
    free(arena.memory);
}

static void the_last_four_candidates_wait(void)
{
    ek_arena arena = line_of(20u);
    CHECK(expected_candidate(&slam) == NULL);
    for (uint32_t k = 0; k < 6u; k++) {
        const ek_loop_candidate candidate = candidate_of(edge_of(k, 10u + k, ORIGIN, 1.0), EK_LOOP_PASSED);
        wait_for_another(&slam, &candidate);
        CHECK(slam.waiting_count == (k < 4u ? k + 1u : 4u));
    }
    for (uint32_t k = 0; k < 4u; k++) {
        CHECK(slam.waiting[k].edge.first == k + 2u);
    }
    CHECK(expected_candidate(&slam) == slam.waiting + 3); /* 15, 4 m behind the last keyframe */
    slam.waiting[3].edge.second = 13u; /* 6 m */
    CHECK(expected_candidate(&slam) == slam.waiting + 3);
    slam.waiting[3].edge.second = 12u;
    CHECK(expected_candidate(&slam) == NULL);
    free(arena.memory);
}

/* What becomes of a judged candidate, with its record. */
static void each_candidate_has_its_record(void)
{
    ek_arena arena = line_of(20u);
    const ek_loop_edge edge = edge_of(2u, 18u, pose_of(16.0, 0.0, 0.0), 1.0);
    for (int k = 0; k < 4; k++) { /* refused; waits; closes a loop; has no room */
        slam.finder.candidate = candidate_of(edge, k == 0 ? EK_LOOP_CHI : EK_LOOP_PASSED);
        slam.finder.candidate.is_local = k >= 2;
        slam.keyframes.graph.loop_count = k == 3 ? LINE_LOOPS : 0u;
        slam.task = EK_TASK_FIND;
        consider(&slam, &work);
        const ek_loop_record *const now = slam.record + k;
        CHECK(slam.record_count == (size_t)k + 1u && now->candidate.edge.second == 18u && now->section == 0u);
        CHECK(now->unconfirmed == (k == 1) && now->accepted == (k == 2) && now->no_room == (k == 3));
        CHECK(!now->found_again && !now->withdrawn && slam.task == (k == 2 ? EK_TASK_SOLVE : EK_TASK_IDLE));
        CHECK(slam.waiting_count == (k == 1 ? 1u : 0u));
        CHECK(k != 2 || (slam.keyframes.graph.loop_count == 1u && slam.record_of_loop[0] == 2u));
    }
    slam.keyframes.graph.loop_count = 0u;
    for (size_t k = 4; k < 10u; k++) {
        slam.finder.candidate = candidate_of(edge, EK_LOOP_SCORE);
        consider(&slam, &work);
        CHECK(slam.record_count == (k < LINE_RECORDS ? k + 1u : LINE_RECORDS));
        CHECK(slam.unrecorded == (k < LINE_RECORDS ? 0u : k + 1u - LINE_RECORDS));
    }
    free(arena.memory);
}

/* A part of the drive after a lost track, by the wheels alone: a loop brings it to its place. Where the graph had predicted
 * another one, the motion by the wheels counts as unknown from then on. */
static void a_loop_to_another_part_moves_this_one(void)
{
    for (int known = 0; known < 2; known++) {
        ek_arena arena = line_of(10u);
        add_keyframe(1.0, EK_STEP_MEASURED);
        add_keyframe(1.0, EK_STEP_MATCHED);
        slam.finder.candidate = candidate_of(edge_of(3u, 11u, pose_of(0.0, 2.0, 0.0), 1.0), EK_LOOP_PASSED);
        slam.finder.candidate.is_local = 1;
        slam.finder.candidate.known = known;
        consider(&slam, &work);
        CHECK(slam.record[0].accepted && slam.record[0].found_again && slam.record[0].section == 1u);
        CHECK_NEAR(slam.keyframes.graph.pose[11].x, 3.0, TOLERANCE);
        CHECK_NEAR(slam.keyframes.graph.pose[11].y, 2.0, TOLERANCE);
        CHECK_NEAR(slam.keyframes.graph.pose[10].x, 2.0, TOLERANCE);
        CHECK_NEAR(slam.keyframes.graph.pose[9].x, 9.0, TOLERANCE);
        CHECK(slam.keyframes.kind[10] == (known ? EK_STEP_MEASURED : EK_STEP_UNKNOWN));
        free(arena.memory);
    }
}

/* The map of keyframes within 30 m of the last one, twice its radius, that are at most 20 m away through the graph. */
static void keyframes_near_the_last_one_are_drawn(void)
{
    for (int slices = 0; slices < 2; slices++) {
        ek_arena arena = line_of(40u);
        slam.parameters.map_radius = EK_R(15.0);
        for (size_t k = 0; k < 40u; k++) {
            slam.keyframes.apart[k] = EK_R(k == 16u ? 20.1 : 20.0);
        }
        slam.next_odom_from_start = pose_of(100.0, 50.0, 0.0);
        slam.redrawn = 7u;
        ek_slam_redraw(&slam);
        CHECK(slam.task == EK_TASK_REDRAW && slam.redrawn == 0u && slam.drawn == 0u);
        unsigned parts = 0u;
        for (; slam.task == EK_TASK_REDRAW; parts++) {
            ek_work slice = ek_work_make(slices ? 1 : INT64_MAX);
            ek_slam_work(&slam, &slice);
            CHECK(!slices || slice.done <= 16u); /* one keyframe of one point, at most */
        }
        CHECK(parts == (slices ? 40u : 1u));
        CHECK(slam.drawn == 1u && slam.map_changed && slam.maps[1].count == 30u); /* 9 to 39, without 16 */
        CHECK_NEAR(drawn_at(slam.maps[1].voxel).x, 109.0, TOLERANCE);
        CHECK_NEAR(drawn_at(slam.maps[1].voxel).y, 51.0, TOLERANCE);
        CHECK_NEAR(slam.odom_from_start.x, 100.0, 0.0);
        CHECK_NEAR(slam.built_at, 39.0, 0.0);
        free(arena.memory);
    }
}

/* With a lost track the map begins anew; a search or a drawing is dropped, an optimisation goes on. */
static void what_is_begun_before_a_lost_track(void)
{
    for (int task = 0; task <= (int)EK_TASK_REDRAW; task++) {
        ek_arena arena = line_of(10u);
        const int dropped = task == (int)EK_TASK_FIND || task == (int)EK_TASK_REDRAW;
        slam.task = (ek_slam_task)task;
        slam.finder.phase = EK_FINDER_DRAW;
        slam.waiting_count = 3u;
        slam.odom_from_keyframe[9] = pose_of(9.0, 5.0, 0.0);
        ek_slam_draw(&slam, 0u, slam.keyframes.points, 4u, AT_BASE, ORIGIN, &work);
        begin_anew(&slam, &work);
        CHECK(slam.task == (dropped ? EK_TASK_IDLE : (ek_slam_task)task) && slam.waiting_count == 0u);
        CHECK(slam.finder.phase == (dropped ? EK_FINDER_IDLE : EK_FINDER_DRAW));
        CHECK(slam.maps[0].count == 1u);
        CHECK_NEAR(drawn_at(slam.maps[0].voxel).x, 9.0, TOLERANCE);
        CHECK_NEAR(drawn_at(slam.maps[0].voxel).y, 6.0, TOLERANCE);
        CHECK_NEAR(slam.odom_from_start.y, 5.0, TOLERANCE);
        CHECK_NEAR(slam.built_at, 9.0, 0.0);
        free(arena.memory);
    }
}

/* Only what is drawn into the map changes it. */
static void drawing_aside_does_not_change_the_map(void)
{
    static const ek_real point[] = {EK_R(1.0), EK_R(0.0)};
    ek_arena arena = line_of(1u);
    for (uint32_t map = 0; map < 2u; map++) {
        slam.map_changed = 0;
        ek_slam_draw(&slam, map, point, 1u, AT_BASE, ORIGIN, &work);
        CHECK(slam.map_changed == (map == 0u) && slam.maps[map].count == 1u);
    }
    free(arena.memory);
}

/* A new keyframe d m ahead: from 5 m of path since the last drawing on, the map is drawn again. The doubt counts for one
 * step. Without room for it the scan is drawn, and nothing else. */
static void a_keyframe_is_inserted(void)
{
    static const double built_at[] = {4.99, 5.0, 5.01};
    for (size_t k = 0; k < 3u; k++) {
        ek_arena arena = line_of(10u);
        slam.scan.hits[0] = EK_R(0.0);
        slam.scan.hits[1] = EK_R(1.0);
        slam.scan.count = 1u;
        slam.built_at = EK_R(built_at[k]);
        slam.doubt.position = slam.doubt.heading = EK_R(2.0);
        slam.wheels.has_last = 1;
        const ek_pose pose = pose_of(10.0, 0.5, 0.25);
        CHECK(ek_slam_insert(&slam, pose, EK_STEP_MATCHED, pose, &work) == EK_OK);
        CHECK(slam.keyframes.count == 11u && !slam.full && slam.maps[0].count == 1u);
        CHECK_NEAR(slam.keyframes.graph.pose[10].y, 0.5, TOLERANCE);
        CHECK_NEAR(slam.odom_from_keyframe[10].theta, 0.25, 0.0);
        CHECK(slam.doubt.position <= EK_R(0.0) && slam.doubt.heading <= EK_R(0.0));
        CHECK_NEAR(1.0 / (double)slam.keyframes.graph.step[10].information.tt, 2.0, 1e-3);
        CHECK(slam.wheels.has_keyframe && slam.wheels.seen == 0);
        const double path = 9.0 + sqrt(1.25);
        CHECK(slam.task == (path - built_at[k] >= 5.0 ? EK_TASK_REDRAW : EK_TASK_IDLE));
        slam.task = EK_TASK_IDLE;
        slam.keyframes.point_capacity = 11u;
        slam.built_at = EK_R(0.0);
        CHECK(ek_slam_insert(&slam, pose, EK_STEP_MATCHED, pose, &work) == EK_OK);
        CHECK(slam.full && slam.keyframes.count == 11u && slam.task == EK_TASK_IDLE);
        free(arena.memory);
    }
    ek_arena arena = line_of(10u);
    slam.scan.count = 0u;
    slam.built_at = EK_R(4.5);
    CHECK(ek_slam_insert(&slam, pose_of(9.5, 0.0, 0.0), EK_STEP_MATCHED, pose_of(9.5, 0.0, 0.0), &work) == EK_OK);
    CHECK(slam.task == EK_TASK_REDRAW); /* exactly 5 m */
    slam.task = EK_TASK_IDLE; /* a step that is not matched is the graph's, from the odometry's last keyframe */
    CHECK(ek_slam_insert(&slam, pose_of(20.0, 0.0, 0.0), EK_STEP_UNKNOWN, pose_of(12.5, 0.0, 0.0), &work) == EK_OK);
    CHECK(slam.keyframes.section[11] == 1u && slam.task == EK_TASK_IDLE);
    CHECK_NEAR(slam.keyframes.graph.pose[11].x, 12.5, TOLERANCE);
    CHECK_NEAR(slam.odom_from_keyframe[11].x, 20.0, 0.0);
    CHECK_NEAR(slam.odom_from_start.x, 7.5, TOLERANCE);
    CHECK(ek_slam_insert(&slam, pose_of(2e7, 0.0, 0.0), EK_STEP_MATCHED, pose_of(2e7, 0.0, 0.0), &work) == EK_OUT_OF_RANGE);
    free(arena.memory);
}

int main(void)
{
    candidates_agree_where_they_measure_one_place();
    a_candidate_is_confirmed_by_itself_or_by_one_that_waits();
    the_last_four_candidates_wait();
    each_candidate_has_its_record();
    a_loop_to_another_part_moves_this_one();
    keyframes_near_the_last_one_are_drawn();
    what_is_begun_before_a_lost_track();
    drawing_aside_does_not_change_the_map();
    a_keyframe_is_inserted();
    return verdict();
}

/* slam_parts.h - parts of slam.h: slam_start.c (parameters, memory), slam.c (one call per scan), slam_prepare.c (wheels and
 * lidar), slam_track.c (what a scan is matched with), slam_match.c (matches), slam_search.c (search of a doubted scan),
 * slam_gate.c (what is expected of a match), slam_loops.c, slam_solve.c. */
#ifndef EK_SLAM_PARTS_H
#define EK_SLAM_PARTS_H

#include "ek/slam.h"

#define ek_noted EK_NAME(noted)
#define ek_slam_start_wheels EK_NAME(slam_start_wheels)
#define ek_slam_period_ns EK_NAME(slam_period_ns)
#define ek_slam_prepare EK_NAME(slam_prepare)
#define ek_slam_observe_wheels EK_NAME(slam_observe_wheels)
#define ek_slam_unevenness EK_NAME(slam_unevenness)
#define ek_slam_note_turn EK_NAME(slam_note_turn)
#define ek_slam_is_paired EK_NAME(slam_is_paired)
#define ek_slam_observe EK_NAME(slam_observe)
#define ek_slam_match EK_NAME(slam_match)
#define ek_slam_search EK_NAME(slam_search)
#define ek_slam_limit EK_NAME(slam_limit)
#define ek_slam_match_directly EK_NAME(slam_match_directly)
#define ek_slam_gate EK_NAME(slam_gate)
#define ek_slam_is_good EK_NAME(slam_is_good)
#define ek_slam_accepts EK_NAME(slam_accepts)
#define ek_slam_doubt EK_NAME(slam_doubt)
#define ek_slam_init EK_NAME(slam_init)
#define ek_slam_is_measured EK_NAME(slam_is_measured)
#define ek_slam_is_keyframe EK_NAME(slam_is_keyframe)
#define ek_slam_take_map EK_NAME(slam_take_map)
#define ek_slam_keep_last EK_NAME(slam_keep_last)
#define ek_slam_forget_last EK_NAME(slam_forget_last)
#define ek_slam_track EK_NAME(slam_track)
#define ek_slam_draw EK_NAME(slam_draw)
#define ek_slam_redraw EK_NAME(slam_redraw)
#define ek_slam_allowed_work EK_NAME(slam_allowed_work)
#define ek_slam_spare_work EK_NAME(slam_spare_work)
#define ek_slam_insert EK_NAME(slam_insert)
#define ek_slam_solve EK_NAME(slam_solve)
#define ek_slam_next_run EK_NAME(slam_next_run)
#define ek_slam_odom_from_start EK_NAME(slam_odom_from_start)
#define ek_slam_work EK_NAME(slam_work)

/* The voxels of the maps are turned against the continuous frame: walls that run along rows of voxels, as they do where a
 * robot starts along a wall, bend the map. */
static const ek_pose ek_grid_from_odom = {EK_R(0.0), EK_R(0.0), EK_R(0.4)};

#define EK_UNUSUAL EK_R(4.0)  /* times the usual error of matches: a match with more is tried again, */
#define EK_DOUBTFUL EK_R(2.0) /* and with more than this it is doubted, with twice that wholly */
#define EK_FARTHEST EK_R(0.5) /* m, and 36 deg: farther from its guess neither a further try nor a match by odometry counts */
#define EK_FARTHEST_THETA (EK_R(36.0) * EK_PI / EK_R(180.0))

/* Initialise in an arena (or measure it). */
ek_status ek_slam_init(ek_slam *slam, ek_arena *arena, const ek_slam_parameters *parameters);

/* Scale 1 for the wheel odometry. */
void ek_slam_start_wheels(ek_slam *slam);

/* What a sweep tells of the wheels and of the lidar; kept once it is taken. */
typedef struct {
    ek_wheels wheels;
    ek_dirt dirt;
    ek_range_noise noise;
    ek_company company;
} ek_noted;

/* The shorter of the last two intervals between scans, this one included; 0 before the third one. */
int64_t ek_slam_period_ns(const ek_slam *slam, const ek_sweep *sweep);

/* The sweep with smoothed ranges, without the speckles of a dirty lidar and without what moves along, and with scaled odometry;
 * `noted` becomes what is known after this sweep. */
ek_sweep ek_slam_prepare(ek_slam *slam, const ek_sweep *sweep, ek_noted *noted);

/* Compare the motion between the last two keyframes as matched with that of the wheels. */
void ek_slam_observe_wheels(ek_slam *slam, ek_pose matched, const ek_openness *open, int known);

/* By how much (rad) the turn within a sweep differs from that at the rate since the last scan, by wheel odometry: deskewing at
 * constant velocity then bends the scan. 0: the turn is even, or unknown, or the last scan was uneven. */
ek_real ek_slam_unevenness(const ek_slam *slam, const ek_sweep *sweep);

/* Note the unevenness of a scan. After an uneven one, note whether the odometry was right over its turn. */
void ek_slam_note_turn(ek_slam *slam, const ek_prior *prior, ek_real by, const ek_slam_estimate *estimate);

/* 1 if at least 80 % of so many points have a pair. */
int ek_slam_is_paired(const ek_match *match, size_t points);

/* Match the projected scan with a target from `guess`; a large scan first with a part of its points. The first answer of a
 * scan that fits poorly is tried again, with near pairs from five headings; `tried` notes it.
 * `predicted`: the pose at constant velocity where a scan without odometry is matched with the map, else NULL. An answer of more
 * than twice the usual error is then tried again, too, from where ek_slam_search finds the scan. If that is not clear, it is
 * tried from headings at `guess`; but from headings at `predicted`, and from `guess`, if the match with the scan before was tried
 * again.
 * `part_suffices`: the answer is only where the match with the map begins. A part of a large scan is matched, and its pairs, if
 * enough, are counted as those of all points. */
ek_status ek_slam_match(ek_slam *slam, const ek_index *target, ek_pose guess, const ek_pose *predicted, int part_suffices,
                        ek_match *match);

/* Without wheel odometry: find the motion of the best score of count points x y on the map, within 0.8 m and 60 deg of `centre`.
 * *alone: 1 if no other heading there scores nearly as well. Returns 0 if there is none, or if the work does not suffice: ten
 * times that allowed to a scan. The grid of scores is drawn first, once for each part of the map that is taken. */
int ek_slam_search(ek_slam *slam, const ek_real *xy, size_t count, ek_pose centre, ek_pose *best, int *alone);

/* Let the observer take the projected scan, once. */
void ek_slam_observe(ek_slam *slam);

/* The answer of a match with a target; what that leaves open is left to the guess (observability.h). */
ek_pose ek_slam_limit(ek_slam *slam, const ek_index *target, ek_pose answer, ek_pose guess);

/* Match the projected scan with the map in few iterations, all points with near pairs, from `pose`, where good odometry puts
 * it. 1 if that leaves the gate `sure`: *pose is then the answer. 0: the scan has to be matched in two stages. */
int ek_slam_match_directly(ek_slam *slam, ek_pose *pose, ek_match *match);

/* How far a match of this scan may be from its guess, by the predicted motion since the last scan. */
ek_gate ek_slam_gate(const ek_slam *slam, int measured, ek_pose last_from_predicted);

/* 1 where the odometry has been so good that no match far from it is accepted. */
int ek_slam_is_good(const ek_gate *gate);

/* 0 where a match of so many points contradicts the odometry that its guess comes from, or fits poorly and leaves a guess that
 * the match before of this scan and the odometry agree on. Sets `sure`. */
int ek_slam_accepts(ek_gate *gate, size_t points, ek_pose guess, ek_pose answer, const ek_match *match);

/* 1 if a match fits about as usual; adds to the doubt of the step: where a match fits poorly or lies farther than usual
 * from the pose that wheel odometry predicts (NULL: without odometry there is no such doubt), the truth may be anywhere
 * between the two. Averages what is usual. */
int ek_slam_doubt(ek_slam *slam, const ek_pose *predicted, ek_pose matched, const ek_match *match);

/* 1 if wheel odometry measured the motion since the last scan. */
int ek_slam_is_measured(const ek_slam *slam, const ek_prior *prior);

/* 1 if a scan at a pose is a keyframe: the first one, or far enough from the last. */
int ek_slam_is_keyframe(const ek_slam *slam, ek_pose odom_from_base);

/* Take the part of the map around a pose, if the map has changed or the robot has moved on. */
ek_status ek_slam_take_map(ek_slam *slam, ek_pose near, ek_work *work);

/* Keep the scan, at its pose, to match and compare the next one with. */
void ek_slam_keep_last(ek_slam *slam, ek_pose odom_from_base);

/* Match the next scan with no scan before it; it is still compared with the one that was kept last. */
ek_status ek_slam_forget_last(ek_slam *slam);

/* Match the projected scan with the last one and with the map; fills stages and odom_from_base. One that is to be set aside is
 * not matched where the odometry is good, and not set aside where it is not. */
ek_status ek_slam_track(ek_slam *slam, const ek_prior *prior, ek_slam_estimate *estimate, ek_work *work);

/* Draw points, in their own frame, where the sensor was at x y, into one of the two maps. */
void ek_slam_draw(ek_slam *slam, uint32_t map, const ek_real *xy, size_t count, const ek_real *sensor, ek_pose odom_from_points,
                  ek_work *work);

/* Begin to draw the map anew, with `next_odom_from_start`. */
void ek_slam_redraw(ek_slam *slam);

/* Operations of the newest scan, in proportion to the shorter of the last two intervals: one gap does not delay a scan. */
int64_t ek_slam_allowed_work(const ek_slam *slam);

/* Further operations while a lost part of the drive is searched for: three times those allowed, less the work of matching, so
 * that a scan that was hard to match has none. */
int64_t ek_slam_spare_work(const ek_slam *slam, int64_t allowed);

/* Make the projected scan a keyframe; `graph_pose`: where the graph has it, in the same frame, which after a lost track is
 * not where it matched. */
ek_status ek_slam_insert(ek_slam *slam, ek_pose odom_from_base, ek_step_kind kind, ek_pose graph_pose, ek_work *work);

/* Begin to optimise all keyframes with the loops; those that contradict the others are withdrawn. */
void ek_slam_solve(ek_slam *slam);

/* The next run of the solver after one has ended; after the last one the map is redrawn. */
void ek_slam_next_run(ek_slam *slam, ek_work *work);

/* The motion between the corrected poses and the continuous frame, at the last keyframe. */
ek_pose ek_slam_odom_from_start(const ek_slam *slam);

/* Go on with the task in hand while work is left. */
void ek_slam_work(ek_slam *slam, ek_work *work);

#endif

/* frontend.h - where the robot is: scan-to-scan, then scan-to-map against the last keyframes (the paper, figures 2, 4).
 *
 * The same meaning as evalkit/odometry/frontend.py with a keyframe local map. Poses are start_from_base: the first
 * answer is the
 * identity.
 */
#ifndef EK_FRONTEND_H
#define EK_FRONTEND_H

#include "ek/icp.h"
#include "ek/merge.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    ek_icp_parameters scan_to_scan, scan_to_map;
    int32_t use_scan_to_scan, use_scan_to_map; /* 1 or 0 */
    int32_t min_inliers;                       /* an answer on fewer pairs is not accepted; the guess is kept */
    uint32_t keyframes;                        /* how many make the local map; 1 or more */
    ek_real keyframe_distance;                 /* m */
    ek_real keyframe_angle;                    /* rad */
    size_t points;                             /* a scan has at most so many */
    size_t cells;                              /* of the index of the local map; 0: 16 for each of its points, at most 2^18 */
} ek_frontend_parameters;

/* What is known about a scan besides its points. */
typedef struct {
    int64_t stamp_ns;
    int32_t has_odometry;
    ek_pose odom_from_base;
} ek_prior;

/* What became of a stage's answer: the stage is off or had nothing before it, its guess was kept, or it was accepted. */
typedef enum { EK_NOT_ASKED = -1, EK_GUESS_KEPT = 0, EK_ACCEPTED = 1 } ek_belief;

/* The answer for one scan; a stage that did not run has 0 iterations and error nan. */
typedef struct {
    ek_pose start_from_base;
    ek_match scan_to_scan, scan_to_map;
    ek_belief scan_to_scan_belief, scan_to_map_belief;
    int32_t keyframe; /* 1: the scan became one */
} ek_answer;

typedef struct {
    ek_frontend_parameters parameters;
    ek_icp icp;
    ek_index last, local_map;
    ek_merge merge;           /* of the local map */
    ek_real *keyframe;        /* points of the newest, pairs x y in the start frame */
    size_t *keyframe_counts;  /* points of each in the local map */
    uint32_t first, held;     /* ring of keyframes: the oldest, and how many */
    int32_t started, has_last_odometry;
    ek_pose start_from_base, start_from_keyframe, odom_from_base, step;
    int64_t stamp_ns, step_ns;
} ek_frontend;

#define ek_frontend_default EK_NAME(frontend_default)
#define ek_frontend_check EK_NAME(frontend_check)
#define ek_frontend_lay_out EK_NAME(frontend_lay_out)
#define ek_frontend_reset EK_NAME(frontend_reset)
#define ek_frontend_steady EK_NAME(frontend_steady)
#define ek_frontend_update EK_NAME(frontend_update)

/* Both stages with ek_icp_default, 10 keyframes every 0.5 m or 20 degrees, 10 inliers, 2048 points. */
ek_frontend_parameters ek_frontend_default(void);

/* EK_OK, EK_NOT_FINITE or EK_OUT_OF_RANGE. */
ek_status ek_frontend_check(const ek_frontend_parameters *parameters);

/* Lays a front end out, ready for a first scan; answers as ek_frontend_check. */
ek_status ek_frontend_lay_out(ek_frontend *frontend, ek_arena *arena, const ek_frontend_parameters *parameters);

/* Forgets everything: the next scan is the first. */
void ek_frontend_reset(ek_frontend *frontend);

/* The base's motion over `elapsed_ns` if it moves on as between the last two scans; the identity before. */
ek_pose ek_frontend_steady(const ek_frontend *frontend, int64_t elapsed_ns);

/* Takes in a scan: count pairs x y in the base frame, motion undone. The first guess comes from odometry where this scan
 * and the one before have it, else from a steady motion. A scan without points gets the guess and never is a keyframe.
 * EK_TOO_MANY_POINTS; EK_NOT_FINITE: a point, the odometry or where it leads; EK_OUT_OF_RANGE: a stamp not after the
 * last, a coordinate or pose beyond EK_LARGEST. After an error the scan is as if it had never come. */
ek_status ek_frontend_update(ek_frontend *frontend, const ek_real *xy, size_t count, const ek_prior *prior,
                             ek_answer *answer);

#ifdef __cplusplus
}
#endif
#endif

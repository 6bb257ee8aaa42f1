/* slam.h - the paper's ICP against a lasting map, with loop closure and a pose graph; one call per scan.
 *
 * Computes the same as evalkit_baselines/slam/paper_slam.py. All memory is the caller's and is fixed at the start. The
 * search for loops, the optimisation and the redrawing of the map are done in slices: each scan works on them until
 * `work` operations are used up, and the scans go on being matched with the map as it is. Without a limit each loop is
 * closed within the scan that found it, as in the reference.
 */
#ifndef EK_SLAM_H
#define EK_SLAM_H

#include "ek/companions.h"
#include "ek/continuity.h"
#include "ek/loop_finder.h"
#include "ek/motion.h"
#include "ek/search.h"
#include "ek/smooth.h"
#include "ek/speckles.h"
#include "ek/sweep_times.h"
#include "ek/voxel_map.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    ek_scan_parameters scan;
    ek_icp_parameters matcher;   /* EK_METRIC_LINE */
    ek_real fine_correspondence; /* m: largest distance of a pair in the last match of a loop, and of all points of a large scan */
    int32_t deskew, use_odometry; /* 1 or 0 */
    int32_t min_inliers;         /* with fewer pairs the result is rejected and the guess kept */
    ek_real keyframe_distance, keyframe_angle; /* m, rad */
    ek_real map_voxel, map_radius; /* m: side of the voxels; scans are matched with those within the radius */
    ek_real map_reach;           /* m: keyframes farther apart through the graph leave the map */
    ek_drift drift;
    ek_loop_settings loop;
    int64_t work;                /* operations (work.h) of a scan for loops, optimisation and map; 0: no limit. Slower
                                    lidars have more, in proportion to the shorter of the last two intervals above 0.1 s,
                                    up to 20 times at 2 s. While a lost part of the drive is searched for it is up to 4
                                    times as much, less 12 for each point and iteration of matching. The search of a scan on
                                    the map, without odometry, has 10 times as much in addition */
    /* room for */
    size_t points;               /* beams and points of a scan */
    size_t keyframes, keyframe_points; /* keyframes, and the points of all of them together */
    size_t loops, records;       /* closed loops, and reported candidates */
    size_t voxels, map_points;   /* voxels of the lasting map, and of its part around the robot */
    size_t loop_points, score_cells; /* of the two maps that a loop compares, and of a level of its score grid */
} ek_slam_parameters;

/* A candidate as reported. */
typedef struct {
    ek_loop_candidate candidate;
    int32_t accepted;    /* the graph uses it now */
    int32_t unconfirmed; /* passed, but neither good enough alone nor confirmed by another one */
    int32_t found_again; /* it placed a part of the drive that began after a lost track */
    int32_t withdrawn;   /* it was accepted, and contradicts other loops */
    int32_t no_room;     /* the memory for loops is used up */
    uint32_t section;    /* the part of the drive of its later keyframe */
} ek_loop_record;

typedef enum {
    EK_TASK_IDLE = 0,
    EK_TASK_FIND,
    EK_TASK_SOLVE,  /* with dynamic covariance scaling */
    EK_TASK_DOUBT,  /* some loop contradicts the others: without a kernel, */
    EK_TASK_ROUND,  /* then rounds of graduated non-convexity, */
    EK_TASK_SETTLE, /* then with the loops that are kept */
    EK_TASK_REDRAW
} ek_slam_task;

/* Result for one scan. */
typedef struct {
    ek_pose start_from_base; /* at the first beam, in the frame of the corrected poses: the first scan is the identity */
    ek_pose odom_from_base;  /* in a frame in which corrections move no pose: for ek_slam_correct */
    ek_match scan_to_scan, scan_to_map;
    int32_t has_scan_to_scan, has_scan_to_map; /* 0: not run; scans are matched with the map alone where odometry is good */
    int32_t scan_to_scan_accepted, scan_to_map_accepted;
    int32_t set_aside; /* 1: the pose is that of the wheels, and nothing is matched with the scan: it lies neither on the one
                        * before nor on the map, or good odometry was right over turns as uneven as that within it */
    int32_t lost;      /* 1: the scan lies on neither, with odometry for more than 2 s; the map begins anew with it */
    int32_t corrected; /* 1: earlier poses changed */
    int32_t full;      /* 1: no memory for another keyframe: no loop is closed any more */
    uint32_t keyframe; /* number of the last one, from 0: for ek_slam_correct */
    uint64_t work;     /* operations of this scan for loops, optimisation and map */
} ek_slam_estimate;

/* Scale of the wheel odometry: matched path over that of the wheels, both since about 50 m (odometry_scale.py). */
typedef struct {
    ek_real matched, driven;      /* m */
    int32_t has_last, has_keyframe;
    int32_t seen;                 /* 1: the walls left no direction open at the last keyframe */
    ek_pose last, scaled;         /* raw and scaled odometry at the last scan */
    ek_pose now;                  /* raw odometry of this scan */
    ek_pose keyframe;             /* raw odometry at the last keyframe */
} ek_wheels;

/* How far a match may be from its guess by wheel odometry (odometry_gate.py). */
typedef struct {
    int32_t measured;      /* 0: the guess is none of wheel odometry */
    ek_real metres, theta; /* m, rad */
    ek_real poor;          /* m: a match with a larger error and few pairs may be at most half as far; 0: unknown */
    ek_real fewest;        /* points: a match of fewer is not accepted where the odometry is good */
    ek_real doubted;       /* m: a match with a larger error is doubted; 0: unknown */
    ek_real near;          /* m: a doubted match may be so far from its guess where the match before is `sure` */
    int32_t sure;          /* 1: the last match of this scan is accepted, agrees with good odometry, and is not doubted */
} ek_gate;

#define EK_TURNS_RIGHT 2

/* The last scan, if the robot turned unevenly within it (uneven_turns.py). */
typedef struct {
    ek_real by, beyond; /* rad: 0: it was even; how far the scan before had turned beyond the odometry */
    int32_t right;      /* so many such turns the odometry was right over, up to EK_TURNS_RIGHT, since it was last wrong */
} ek_uneven;

/* Read only. The candidates so far are record[0] to record[record_count - 1]. */
typedef struct {
    ek_slam_parameters parameters;
    ek_motion motion;
    ek_scan scan;
    ek_icp icp;
    ek_index last, map_index;
    ek_real *last_points, *last_normals, *map_normals, *map_points;
    size_t last_count;       /* points of the scan before, */
    int32_t last_indexed;    /* which are indexed when they are matched, */
    int32_t last_compared;   /* and prepared when another scan is compared with them; */
    int32_t last_outdated;   /* 1: the scan that was prepared last is older than the one before */
    ek_pose last_odom_from_base, last_base_from_sensor;
    uint32_t *map_support;   /* points of each mean in map_points, */
    ek_real *map_seen_from;  /* and the mean of unit vectors x y to where they were seen from */
    ek_thinner thinner;
    ek_observer observer;
    ek_continuity continuity;
    ek_voxel_map maps[2];    /* the map, and the one that is being drawn */
    uint32_t drawn;          /* which of them is the map */
    ek_real *moved, *stored;
    ek_score_grid around;    /* scores of the map around the robot, without odometry */
    ek_search search;        /* in it */
    ek_real *means;          /* of the map in its cells */
    int32_t around_drawn;    /* 1: of the part of the map as it is */
    int32_t *cells;
    ek_real centre_x, centre_y; /* of the part of the map around the robot */
    int32_t map_changed, has_keyframe, tried;
    int32_t closed, observed; /* of this scan: nothing is open; the observer has taken it */
    uint64_t matching;       /* points times iterations of matching this scan */
    ek_pose odom_from_front; /* of the front end's last keyframe, */
    size_t front_count;      /* whose scan had so many points */
    int32_t in_room;         /* at the last keyframe */
    ek_keyframes keyframes;
    ek_pose *odom_from_keyframe;
    ek_pose odom_from_start, next_odom_from_start;
    ek_loop_finder finder;
    ek_loop_candidate waiting[4];
    uint32_t waiting_count;
    ek_loop_record *record;
    size_t record_count;
    uint32_t *record_of_loop;
    ek_slam_task task;
    ek_wheels wheels;
    ek_dirt dirt;
    ek_range_noise noise;
    ek_sweep_times sweeps;   /* of scans without times of beams */
    ek_view views[3];
    ek_company company;      /* which of the views are kept */
    ek_doubt doubt;          /* of the step since the last keyframe */
    ek_real usual_error;     /* m: of matches with the map */
    ek_real usual_points;    /* of scans whose match is accepted */
    ek_real usual_gap, usual_turn; /* m, rad: between them and the odometry */
    uint32_t compared;       /* scans with odometry before this one, as far as they are counted */
    ek_gate gate;            /* of this scan */
    int64_t fitted_ns;       /* stamp of the last scan that fitted */
    ek_uneven uneven;
    ek_real *cleaned;
    int32_t undecided, corrected, full, rounds;
    ek_real mu, built_at;
    size_t redrawn;
    uint64_t unrecorded; /* candidates for which there was no room */
} ek_slam;

#define ek_slam_default EK_NAME(slam_default)
#define ek_slam_bytes EK_NAME(slam_bytes)
#define ek_slam_start EK_NAME(slam_start)
#define ek_slam_update EK_NAME(slam_update)
#define ek_slam_correct EK_NAME(slam_correct)

/* Default parameters: those of the reference; memory for 2048 points a scan, 2000 keyframes of 500 points, 64 loops. */
ek_slam_parameters ek_slam_default(void);

/* Compute how many bytes ek_slam_start needs besides the struct. EK_NULL_POINTER; EK_NOT_FINITE or EK_OUT_OF_RANGE for wrong
 * parameters and for more memory than this processor can address: *bytes is then 0. */
ek_status ek_slam_bytes(const ek_slam_parameters *parameters, size_t *bytes);

/* Initialise in memory aligned to EK_ALIGNMENT, which must outlive it. EK_TOO_LITTLE_MEMORY, or what ek_slam_bytes
 * returns. */
ek_status ek_slam_start(ek_slam *slam, void *memory, size_t bytes, const ek_slam_parameters *parameters);

/* Process a sweep: match it, and go on with loops, optimisation and map. Returns what ek_motion_project returns;
 * EK_NULL_POINTER; EK_NOT_FINITE: the odometry; EK_OUT_OF_RANGE: a stamp not later than the last, a sensor farther than 1 km
 * from the base, an odometry beyond EK_MAX_COORDINATE, or a pose or point beyond a quarter of it. An error changes no state;
 * what *estimate holds then has no meaning. */
ek_status ek_slam_update(ek_slam *slam, const ek_sweep *sweep, ek_slam_estimate *estimate);

/* The corrected pose of a scan, start_from_base, from `keyframe` and `odom_from_base` of its estimate, which the caller keeps.
 * Between two keyframes the correction is distributed by the driven distance. */
ek_pose ek_slam_correct(const ek_slam *slam, uint32_t keyframe, ek_pose odom_from_base);

#ifdef __cplusplus
}
#endif
#endif

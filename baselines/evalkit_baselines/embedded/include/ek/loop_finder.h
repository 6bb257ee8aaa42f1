/* loop_finder.h - find and verify loop closures: place, branch and bound, ICP, overlap, observability, chi-square; in
 * slices.
 *
 * Computes the same as evalkit_baselines/slam/loop_finder.py, which gives the reasons. Points of several keyframes are
 * taken as far as there is memory for them, those nearest along the path first.
 */
#ifndef EK_LOOP_FINDER_H
#define EK_LOOP_FINDER_H

#include "ek/icp.h"
#include "ek/keyframes.h"
#include "ek/search.h"
#include "ek/sight.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    ek_real path;       /* m: a loop is at least so long through the graph */
    ek_real spacing;    /* m: path between two candidates */
    ek_real radius;     /* m: largest distance of a candidate, and half the search window */
    ek_real submap;     /* m: path on either side of a keyframe whose points are matched */
    ek_real cell;       /* m: of branch and bound */
    ek_real score;      /* smallest score of branch and bound */
    ek_real ambiguity;  /* share of the best score that another motion may not reach */
    ek_real near;       /* m: a point within this distance lies on the other map */
    ek_real overlap;    /* smallest share of points on the other map */
    ek_real in_view;    /* smallest share of points on the other map among those that its scans could see, where score and overlap
                         * reach only three quarters of their limits */
    ek_real degenerate; /* m: largest 1-sigma error of the matched position */
    ek_real gate;       /* largest chi-square of a confirmed closure */
    ek_real quick_gate; /* and of one without confirmation */
} ek_loop_settings;

typedef enum {
    EK_LOOP_PASSED = 0, /* numbers: chi-square, overlap */
    EK_LOOP_FEW_POINTS, /* points, fewest that are enough */
    EK_LOOP_SCORE,      /* upper bound on the score of every motion, smallest that is enough */
    EK_LOOP_AMBIGUOUS,  /* share of the best score, best score */
    EK_LOOP_OVERLAP,    /* overlap, smallest that is enough */
    EK_LOOP_DEGENERATE, /* m: 1-sigma error, largest that is allowed */
    EK_LOOP_CHI,        /* chi-square, gate */
    EK_LOOP_CONTRADICTED /* share on the other map of the points that its scans could see, smallest that is enough */
} ek_loop_outcome;

typedef struct {
    ek_loop_edge edge;
    ek_loop_outcome outcome;
    ek_real number[2]; /* what decided: see ek_loop_outcome */
    ek_real chi;     /* of the residual; nan where it was not computed */
    int32_t is_local; /* the search window was small */
    int32_t known;   /* the graph predicted the motion */
} ek_loop_candidate;

typedef enum {
    EK_FINDER_IDLE = 0,
    EK_FINDER_PREDICT,
    EK_FINDER_TARGET,
    EK_FINDER_SOURCE,
    EK_FINDER_DRAW,
    EK_FINDER_RAISE,
    EK_FINDER_SEARCH,
    EK_FINDER_RIVAL,
    EK_FINDER_INDEX,
    EK_FINDER_COARSE,
    EK_FINDER_FINE,
    EK_FINDER_JUDGE,
    EK_FINDER_LOOK
} ek_finder_phase;

typedef struct {
    ek_loop_settings settings;
    ek_icp_parameters coarse, fine;
    size_t capacity; /* points of either map, before thinning */
    ek_finder_phase phase;
    int32_t tried;
    uint32_t turn;  /* of five, while another part of the drive is not connected */
    ek_real tried_at; /* m */
    size_t next_place;
    /* the candidate in work */
    ek_loop_candidate candidate;
    int32_t apart;  /* both belong to parts of the drive that no closure connects */
    int32_t turned; /* not even the heading is predicted */
    ek_pose motion, match;
    ek_sym3 covariance;
    ek_real match_error, best_score, half[3];
    ek_pose best;
    uint32_t level, rival, gathered, gather_end;
    size_t raw_count, target_count, source_count, sample_count;
    size_t on_map, missing; /* points of the source on the target, and behind them in `raw` those that it hides, as far as
                             * is known */
    /* working memory */
    ek_real *raw, *target, *source, *sample, *normals;
    ek_index index;
    ek_icp icp;
    ek_score_grid grid;
    ek_search search;
    ek_observer observer;
    ek_thinner thinner;
    ek_sight sight; /* in the memory of `sample` and `normals` */
} ek_loop_finder;

#define ek_loop_default EK_NAME(loop_default)
#define ek_loop_check EK_NAME(loop_check)
#define ek_loop_finder_init EK_NAME(loop_finder_init)
#define ek_loop_finder_begin EK_NAME(loop_finder_begin)
#define ek_loop_finder_work EK_NAME(loop_finder_work)

/* Default settings: those of the reference. */
ek_loop_settings ek_loop_default(void);

/* Check settings: EK_OK, EK_NULL_POINTER, EK_NOT_FINITE or EK_OUT_OF_RANGE. */
ek_status ek_loop_check(const ek_loop_settings *settings);

/* Initialise in an arena (or measure it): `points` of either map, `cells` of the score grid (score_grid.h), ICP parameters
 * of the first and of the final match. EK_NULL_POINTER; what ek_loop_check and the init functions of its parts return. */
ek_status ek_loop_finder_init(ek_loop_finder *finder, ek_arena *arena, const ek_loop_settings *settings,
                              const ek_icp_parameters *coarse, const ek_icp_parameters *fine, size_t points, size_t cells);

/* Look for a place to compare with the last keyframe; 1: there is one, and a candidate is in work. `expected`: an
 * unconfirmed one, beside which another one may confirm it, or NULL. `measured`: the keyframe has wheel odometry. Four
 * operations a keyframe. The graph must not be in work. */
int ek_loop_finder_begin(ek_loop_finder *finder, ek_keyframes *keyframes, const ek_loop_candidate *expected, int measured,
                         ek_work *work);

/* Go on with the candidate while work is left; 1: finder->candidate is judged. The largest part is one match: at most
 * 40 iterations of the points of the source, 12 operations each. */
int ek_loop_finder_work(ek_loop_finder *finder, ek_keyframes *keyframes, ek_work *work);

#ifdef __cplusplus
}
#endif
#endif

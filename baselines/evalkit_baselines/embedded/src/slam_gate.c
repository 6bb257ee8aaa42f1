/* What slam.h expects of a match: how far it may be from its guess by odometry (odometry_gate.py), and the doubt that it leaves
 * (match_doubt.py). */
#include "slam_parts.h"

#define UNLIKELY EK_R(20.0)  /* times the usual gap to the odometry: a match farther than this from its guess by odometry is too far, */
#define NEAREST EK_R(0.3)    /* m, and 20 deg, and STEP_SHARE of the step: a nearer match is not, and one beyond EK_FARTHEST is, */
#define NEAREST_THETA (EK_R(20.0) * EK_PI / EK_R(180.0))
#define STEP_SHARE EK_R(0.25)
#define CLEAR EK_R(0.04)     /* m: unless it has converged to a smaller error with CLEAR_SHARE of the points in pairs */
#define CLEAR_SHARE EK_R(0.9)
#define POOR_SHARE EK_R(0.5) /* of these limits: of a match with EK_UNUSUAL times the usual error and too few pairs */
#define FEWEST EK_R(40.0)    /* points: where good odometry lowers the limits, a match of fewer is not accepted; */
#define TIMES_FEWER EK_R(3.0) /* of a lidar with few beams, of one with so many times fewer than usual */
#define USUAL_COUNT 50u      /* scans over which the usual error of matches, and gap to the odometry, are averaged */
#define USUAL_SCANS EK_R(50.0)
#define APART EK_R(3.0)      /* times the usual gap to the odometry: beyond it a match is doubted, beyond twice that wholly */
#define FIRST_GAP EK_R(0.01) /* m: odometry is thought to be no better than this, */
#define GAP_SHARE EK_R(0.05) /* and this share of its step, */
#define FIRST_TURN EK_R(0.01) /* rad: nor in heading */

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
    ek_gate gate = {measured, EK_FARTHEST, EK_FARTHEST_THETA, EK_UNUSUAL * slam->usual_error, fewest < FEWEST ? fewest : FEWEST,
                    EK_DOUBTFUL * slam->usual_error, APART * usual_gap_of(slam, step), 0};
    if (slam->compared >= USUAL_COUNT) {
        const ek_real length = EK_SQRT(step.x * step.x + step.y * step.y), turn = EK_FABS(step.theta);
        gate.metres = limit_of(slam->usual_gap, NEAREST + STEP_SHARE * length, EK_FARTHEST);
        gate.theta = limit_of(slam->usual_turn, NEAREST_THETA + STEP_SHARE * turn, EK_FARTHEST_THETA);
    }
    return gate;
}

int ek_slam_is_good(const ek_gate *gate)
{
    return gate->measured && gate->metres < EK_FARTHEST;
}

int ek_slam_accepts(ek_gate *gate, size_t points, ek_pose guess, ek_pose answer, const ek_match *match)
{
    const ek_pose gap = ek_se2_between(guess, answer);
    const ek_real squared = gap.x * gap.x + gap.y * gap.y;
    const int paired = ek_slam_is_paired(match, points);
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
    return ek_slam_is_paired(match, slam->scan.count) ? share_over(match->error, EK_DOUBTFUL * usual) : EK_R(1.0);
}

int ek_slam_doubt(ek_slam *slam, const ek_pose *predicted, ek_pose matched, const ek_match *match)
{
    const ek_real usual = slam->usual_error > EK_R(0.0) ? slam->usual_error : match->error;
    const ek_real share = misfit_of(slam, match, usual);
    slam->usual_error = take_mean(usual, match->error, EK_DOUBTFUL * usual);
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

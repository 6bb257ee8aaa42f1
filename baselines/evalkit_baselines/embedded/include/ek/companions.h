/* companions.h - leave out what moves along with the robot: its own body in view, or somebody who walks with it.
 *
 * Computes the same as evalkit_baselines/slam/companions.py, which gives the reasons.
 */
#ifndef EK_COMPANIONS_H
#define EK_COMPANIONS_H

#include "ek/se2.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ek_view EK_NAME(view)
#define ek_company EK_NAME(company)
#define ek_drop_companions EK_NAME(drop_companions)

#define EK_SECTORS 120

/* The nearest range in each sector of a scan (m, infinite: none), and the pose of the sensor by wheel odometry. */
typedef struct {
    ek_real nearest[EK_SECTORS];
    ek_pose odom_from_sensor;
} ek_view;

/* Zeroed: before the first scan. */
typedef struct {
    uint32_t older, newer; /* of three views those that are kept, from 1; 0: none */
    uint32_t scans;        /* of which `often` is the mean */
    ek_real often;         /* share of scans in which something moved along */
} ek_company;

/* Set the ranges (m) of beams at angles (rad) to nan where they hit what moves along; hits are the ranges within [low, high],
 * low >= 0. Draws the one of three views that `company` does not keep, and notes in `company` which are kept from now on: where
 * the old `company` is used again, nothing has changed. Returns how many were left out. */
size_t ek_drop_companions(ek_view *views, ek_company *company, ek_real *ranges, const ek_real *angles, size_t beams, ek_real low,
                          ek_real high, ek_pose odom_from_sensor);

#ifdef __cplusplus
}
#endif
#endif

/* smooth.h - smooth the ranges of a noisy lidar with fine beams: the median of neighbouring beams.
 *
 * Computes the same as evalkit_baselines/slam/range_noise.py, which gives the reasons.
 */
#ifndef EK_SMOOTH_H
#define EK_SMOOTH_H

#include "ek/real.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ek_smooth_ranges EK_NAME(smooth_ranges)

/* Smooth ranges (m; nan or infinite: invalid) of beams at angles (rad) into `smoothed`, another array with room for as many.
 * 1: done; 0: beams are wide or the noise is small, and `smoothed` is not used. */
int ek_smooth_ranges(const ek_real *ranges, const ek_real *angles, size_t beams, ek_real *smoothed);

#ifdef __cplusplus
}
#endif
#endif

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

#define ek_range_noise EK_NAME(range_noise)
#define ek_smooth_ranges EK_NAME(smooth_ranges)
#define ek_range_noise_observe EK_NAME(range_noise_observe)
#define ek_is_noisy EK_NAME(is_noisy)

/* How noisy a lidar is; all 0 before the first scan. */
typedef struct {
    ek_real share;  /* of scans whose ranges were smoothed, mean */
    uint32_t scans; /* of which this is the mean */
} ek_range_noise;

/* Smooth ranges (m; nan or infinite: invalid) of beams at angles (rad) into `smoothed`, another array with room for as many.
 * 1: done; 0: beams are wide or the noise is small, and `smoothed` is not used. */
int ek_smooth_ranges(const ek_real *ranges, const ek_real *angles, size_t beams, ek_real *smoothed);

/* Count a scan whose ranges were smoothed (1) or not (0). */
void ek_range_noise_observe(ek_range_noise *noise, int smoothed);

/* 1: most scans were smoothed. */
int ek_is_noisy(const ek_range_noise *noise);

#ifdef __cplusplus
}
#endif
#endif

/* speckles.h - leave out single beams of a dirty lidar whose range has nothing to do with those of their neighbours.
 *
 * Computes the same as evalkit_baselines/slam/speckles.py, which gives the reasons.
 */
#ifndef EK_SPECKLES_H
#define EK_SPECKLES_H

#include "ek/real.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ek_dirt EK_NAME(dirt)
#define ek_dirt_default EK_NAME(dirt_default)
#define ek_is_dirty EK_NAME(is_dirty)
#define ek_drop_speckles EK_NAME(drop_speckles)

typedef struct {
    ek_real share;  /* of speckles among the hits of a scan, mean */
    uint32_t scans; /* of which this is the mean */
} ek_dirt;

/* Before the first scan. */
ek_dirt ek_dirt_default(void);

/* 1: speckles are left out. */
int ek_is_dirty(const ek_dirt *dirt);

/* Copy ranges (m) of beams at angles (rad) to `dropped`, which may be the same array and has room for as many; those of
 * speckles become nan if the lidar is dirty, this scan included. Hits are the ranges within [low, high], low >= 0; after the
 * last beam comes the first. Returns the number of speckles left out. */
size_t ek_drop_speckles(const ek_real *ranges, const ek_real *angles, size_t beams, ek_real low, ek_real high, ek_dirt *dirt,
                        ek_real *dropped);

#ifdef __cplusplus
}
#endif
#endif

/* sight.h - what a sensor saw in each direction, and whether it could have seen other points. */
#ifndef EK_SIGHT_H
#define EK_SIGHT_H

#include "ek/arena.h"
#include "ek/real.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A direction from the sensor, and how far it saw there. */
typedef struct {
    ek_real bearing, range; /* rad, m */
} ek_sight_ray;

typedef struct {
    size_t rays;
    ek_sight_ray *ray, *other; /* by bearing, and working memory of the sort; memory of the caller */
} ek_sight;

#define EK_SIGHT_WORK 50u /* operations for a point that is taken, and for one that is asked */

#define ek_sight_take EK_NAME(sight_take)
#define ek_sight_could_see EK_NAME(sight_could_see)

/* Take what a sensor at x, y saw: count pairs in the same frame (m), at most as many as there is memory for. */
void ek_sight_take(ek_sight *sight, const ek_real *xy, size_t count, ek_real x, ek_real y);

/* 1 if the sensor could have seen a point that lies x, y from it (m, along the axes of that frame): next to a direction in
 * which it saw something, at most `behind` (m) behind that. */
int ek_sight_could_see(const ek_sight *sight, ek_real x, ek_real y, ek_real behind);

#ifdef __cplusplus
}
#endif
#endif

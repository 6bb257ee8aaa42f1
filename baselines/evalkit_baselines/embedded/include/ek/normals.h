/* normals.h - normals of a cloud: the direction across the line through each point and its neighbours. */
#ifndef EK_NORMALS_H
#define EK_NORMALS_H

#include "ek/index.h"

#ifdef __cplusplus
extern "C" {
#endif

#define EK_MAX_NEIGHBOURS 64u

#define ek_normals_compute EK_NAME(normals_compute)
#define ek_normals_defer EK_NAME(normals_defer)
#define ek_normals_ensure EK_NAME(normals_ensure)

/* Compute the unit normal of each point of an index: the eigenvector for the smaller eigenvalue of the covariance of
 * its nearest `neighbours` points, itself included (all points if there are fewer; of equally near points the lowest
 * indices). If the index is `noisy`, a point that is the mean of n points counts as n (its `support`). normals: one pair
 * x y per point, in the order of the cloud. A normal has y > 0, or is (-1, 0). Where the neighbours have no direction (a
 * single point, coincident points, equal eigenvalues) it is (0, 1).
 * radius: points at this distance (m) or farther are no neighbours; where fewer than three are left, or all coincide, the
 * normal is (0, 0). EK_FAR: no such limit.
 * EK_OUT_OF_RANGE: neighbours below 2 or above EK_MAX_NEIGHBOURS, a radius that is not positive. */
ek_status ek_normals_compute(const ek_index *index, size_t neighbours, ek_real radius, ek_real *normals);

/* Give an index normals that are computed when a registration first needs them, without a radius: those of
 * ek_normals_compute to the bit. normals: memory for one pair per point. An index with such normals must not be used by two
 * threads at once. EK_OUT_OF_RANGE: neighbours below 2 or above EK_MAX_NEIGHBOURS. */
ek_status ek_normals_defer(ek_index *index, size_t neighbours, ek_real *normals);

/* Compute the normal of the point in a slot of such an index unless it is known. *first: half width of the first search (m,
 * above 0; at first a cell's width), afterwards that for a point beside this one; it affects speed alone. */
void ek_normals_ensure(const ek_index *index, uint32_t slot, ek_real *first);

#ifdef __cplusplus
}
#endif
#endif

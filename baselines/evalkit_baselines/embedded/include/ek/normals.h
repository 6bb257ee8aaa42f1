/* normals.h - normals of a cloud: the direction across the line through each point and its neighbours. */
#ifndef EK_NORMALS_H
#define EK_NORMALS_H

#include "ek/index.h"

#ifdef __cplusplus
extern "C" {
#endif

#define EK_MAX_NEIGHBOURS 64u

#define ek_normals_compute EK_NAME(normals_compute)

/* Compute the unit normal of each point of an index: the eigenvector for the smaller eigenvalue of the covariance of
 * its nearest `neighbours` points, itself included (all points if there are fewer; of equally near points the lowest
 * indices). normals: one pair x y per point, in the order of the cloud. A normal has y > 0, or is (-1, 0). Where the
 * neighbours have no direction (a single point, coincident points, equal eigenvalues) it is (0, 1).
 * radius: points at this distance (m) or farther are no neighbours; where fewer than three are left, or all coincide, the
 * normal is (0, 0). EK_FAR: no such limit.
 * EK_OUT_OF_RANGE: neighbours below 2 or above EK_MAX_NEIGHBOURS, a radius that is not positive. */
ek_status ek_normals_compute(const ek_index *index, size_t neighbours, ek_real radius, ek_real *normals);

#ifdef __cplusplus
}
#endif
#endif

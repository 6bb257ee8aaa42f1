/* icp_parts.h - parts of icp.h: loops over lanes (icp_lanes.c), searches (icp_search.c), pairs and their error (icp_pairs.c). */
#ifndef EK_ICP_PARTS_H
#define EK_ICP_PARTS_H

#include "ek/icp.h"
#include "ek/table.h"
#include "ek/wide.h"

#define EK_ICP_ABREAST (32u / sizeof(ek_real)) /* points whose candidates lie side by side: a register of AVX2 */
#define EK_ICP_ROUNDED_DOWN (EK_R(1.0) - EK_R(8.0) * EK_EPSILON)

#define ek_icp_move EK_NAME(icp_move)
#define ek_icp_choose EK_NAME(icp_choose)
#define ek_icp_choose_lowest EK_NAME(icp_choose_lowest)
#define ek_icp_take_slots EK_NAME(icp_take_slots)
#define ek_icp_list_stale EK_NAME(icp_list_stale)
#define ek_icp_search EK_NAME(icp_search)
#define ek_icp_load_candidates EK_NAME(icp_load_candidates)
#define ek_icp_take_line EK_NAME(icp_take_line)
#define ek_icp_take_normals EK_NAME(icp_take_normals)
#define ek_icp_weigh_within EK_NAME(icp_weigh_within)
#define ek_icp_select_pairs EK_NAME(icp_select_pairs)
#define ek_icp_measure_distances EK_NAME(icp_measure_distances)
#define ek_icp_compute_error EK_NAME(icp_compute_error)
#define ek_icp_fit_step EK_NAME(icp_fit_step)

/* EK_ICP_ABREAST, or EK_LANES with AVX-512. */
static inline size_t ek_icp_abreast(const ek_icp *icp)
{
    return icp->wide == EK_AVX512 ? EK_LANES : EK_ICP_ABREAST;
}

/* Coordinate (m) of what stands for candidate k where there is none: two of one point are not equally far. */
static inline ek_real ek_icp_far_away(size_t k)
{
    return EK_FAR * (ek_real)(k + 1u);
}

/* Where the first candidate of a point is; the next one is `abreast` further. */
static inline size_t ek_icp_first_candidate(size_t i, size_t abreast)
{
    return EK_BLOCK * (i & ~(abreast - 1u)) + (i & (abreast - 1u));
}

/* Move the source points by a pose; compute the distance to their target points, and the slack. */
void ek_icp_move(const ek_icp *icp, size_t padded, ek_pose pose, ek_real limit, ek_real margin);

/* Choose the nearest of the candidates of each point, of equals the first, and give it weight 1 if the square of its distance
 * is below `reach` (m^2), else 0. Returns how often two were equally near if `ties` is 1, else 0. */
ek_real ek_icp_choose(const ek_icp *icp, size_t padded, ek_real reach, int ties);

/* Choose of the candidates of a point that are exactly as near as the chosen one that with the lowest index in the cloud. */
void ek_icp_choose_lowest(const ek_icp *icp, const ek_index *target, size_t count);

/* Take the chosen candidate of each point as its neighbour. */
void ek_icp_take_slots(const ek_icp *icp, size_t padded);

/* List the points whose neighbour may have changed; returns their number. */
uint32_t ek_icp_list_stale(const ek_icp *icp, size_t padded);

/* Search the neighbour of every point whose neighbour may have changed; returns the number of searches. */
uint32_t ek_icp_search(ek_icp *icp, const ek_index *target, const ek_real *normals, size_t padded, ek_real limit);

/* Load the candidates of the points whose neighbour may have changed, from the table of the target, or found in groups;
 * returns the number of searches. */
uint32_t ek_icp_load_candidates(ek_icp *icp, const ek_index *target, size_t padded, ek_real limit);

/* Take the normal of the target point of a pair, and whether it was seen from the same side: a thin wall has a face on
 * either side. */
void ek_icp_take_line(ek_icp *icp, const ek_index *target, const ek_real *normals, uint32_t i, uint32_t slot);

/* Take the normals of the neighbours where these have changed. */
void ek_icp_take_normals(ek_icp *icp, const ek_index *target, const ek_real *normals, size_t padded);

/* Give weight 1 to the points that are nearer than `limit` (m), 0 to the others. */
void ek_icp_weigh_within(const ek_icp *icp, size_t padded, ek_real limit);

/* Leave weight 1 to every pair that is used; returns their number (equation 2). Distances or their squares. */
int32_t ek_icp_select_pairs(const ek_icp *icp, size_t padded, const ek_real *distance, int sided, int one_to_one);

/* Distances of the source points to the target points of their pairs, from the squares of ek_icp_choose. */
void ek_icp_measure_distances(ek_icp *icp, size_t padded);

/* Error over the pairs (equation 5), in the unit of the stop rule. */
ek_real ek_icp_compute_error(ek_icp *icp, size_t padded, int32_t pairs, const ek_icp_parameters *parameters);

/* The step of the pairs at a pose, in the target's frame. */
ek_pose ek_icp_fit_step(ek_icp *icp, const ek_index *target, size_t padded, ek_pose pose, const ek_icp_parameters *parameters);

#endif

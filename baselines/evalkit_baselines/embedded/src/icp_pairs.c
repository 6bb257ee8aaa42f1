/* The pairs of icp.h: their lines, which of them are used, their error and their step. */
#include "ek/fit.h"
#include "ek/normals.h"
#include "icp_parts.h"

#define ALIKE (EK_R(16.0) * EK_EPSILON) /* share of a square: squares that differ by more have different roots */
#define CLEAR_VIEW EK_R(0.1)  /* share across its line of the directions that a target point was seen from: less is no side */
#define CLEAR_LOOK EK_R(0.02) /* the same for the direction to where the source points were seen from */

void ek_icp_take_line(ek_icp *icp, const ek_index *target, const ek_real *normals, uint32_t i, uint32_t slot)
{
    const size_t id = target->id[slot];
    const ek_real nx = icp->nx[i] = normals[2u * id], ny = icp->ny[i] = normals[2u * id + 1u];
    if (target->seen_from) {
        const ek_real x = icp->viewer_x - target->xy[2u * slot], y = icp->viewer_y - target->xy[2u * slot + 1u];
        const ek_real from = nx * target->seen_from[2u * id] + ny * target->seen_from[2u * id + 1u], to = nx * x + ny * y;
        const int clear = EK_FABS(from) > CLEAR_VIEW && to * to > CLEAR_LOOK * CLEAR_LOOK * (x * x + y * y);
        icp->facing[i] = clear && (from < EK_R(0.0)) != (to < EK_R(0.0)) ? EK_R(0.0) : EK_R(1.0);
    }
}

/* List the points with weight 1 whose normal is not that of their neighbour; returns their number. */
static uint32_t list_turned(size_t padded, const uint32_t *EK_RESTRICT nearest, const uint32_t *EK_RESTRICT lined,
                            const ek_real *EK_RESTRICT weight, uint32_t *EK_RESTRICT turned)
{
    uint32_t count = 0u;
    for (uint32_t i = 0; i < padded; i += EK_LANES) {
        for (uint32_t k = i; k < i + EK_LANES; k++) {
            turned[count] = k;
            count += (nearest[k] != lined[k]) & (weight[k] > EK_R(0.0));
        }
    }
    return count;
}

void ek_icp_take_normals(ek_icp *icp, const ek_index *target, const ek_real *normals, size_t padded)
{
    const uint32_t count = list_turned(padded, icp->nearest, icp->lined, icp->weight, icp->stale);
    ek_real first = target->cells.cell;
    for (uint32_t k = 0; k < count; k++) {
        const uint32_t i = icp->stale[k], slot = icp->nearest[i];
        if (target->deferred) {
            ek_normals_ensure(target, slot, &first);
        }
        ek_icp_take_line(icp, target, normals, i, slot);
        icp->lined[i] = slot;
    }
}

/* Give weight 1 to the points that are nearer than `limit` (m), 0 to the others. */
static void weigh_within(size_t padded, ek_real limit, const ek_real *EK_RESTRICT distance,
                          ek_real *EK_RESTRICT weight)
{
    for (size_t i = 0; i < padded; i++) {
        weight[i] = distance[i] < limit ? EK_R(1.0) : EK_R(0.0);
    }
}

void ek_icp_weigh_within(const ek_icp *icp, size_t padded, ek_real limit)
{
    weigh_within(padded, limit, icp->distance, icp->weight);
}

/* Set the weights of pairs whose target points were seen from the other side to 0. */
static void keep_facing(size_t padded, const ek_real *EK_RESTRICT facing, ek_real *EK_RESTRICT weight)
{
    for (size_t i = 0; i < padded; i++) {
        weight[i] *= facing[i];
    }
}

/* Whether one distance is smaller, of distances or of their squares: two squares may have the same root. The only branch is
 * one that is hardly ever taken. */
static inline int is_closer(ek_real one, ek_real other, int squared)
{
    if (squared && EK_FABS(other - one) < ALIKE * other) {
        return EK_SQRT(one) < EK_SQRT(other);
    }
    return one < other;
}

/* Of several source points with the same target point, set the weights of all but the closest to 0, of equals of all but
 * the first. `owner` is at first the first source point of each target point; only the later ones, which are few, are
 * compared. No loop has a branch that a processor would have to predict. */
static void keep_closest(size_t padded, const uint32_t *EK_RESTRICT nearest, const ek_real *EK_RESTRICT distance,
                         int squared, uint32_t *EK_RESTRICT owner, uint32_t *EK_RESTRICT later, ek_real *EK_RESTRICT weight)
{
    uint32_t count = 0u;
    for (size_t i = padded; i > 0u; i -= EK_LANES) {
        for (size_t k = 1; k <= EK_LANES; k++) {
            owner[nearest[i - k]] = (uint32_t)(i - k);
        }
    }
    for (uint32_t i = 0; i < padded; i += EK_LANES) {
        for (uint32_t k = i; k < i + EK_LANES; k++) {
            later[count] = k;
            count += owner[nearest[k]] != k;
        }
    }
    for (uint32_t k = 0; k < count; k++) {
        const uint32_t i = later[k], rival = owner[nearest[i]];
        const uint32_t closer = 0u - (uint32_t)is_closer(distance[i], distance[rival], squared), swap = (i ^ rival) & closer;
        owner[nearest[i]] = rival ^ swap;
        weight[i ^ swap] = EK_R(0.0);
    }
}

int32_t ek_icp_select_pairs(const ek_icp *icp, size_t padded, const ek_real *distance, int sided, int one_to_one)
{
    if (sided) {
        keep_facing(padded, icp->facing, icp->weight);
    }
    if (one_to_one) {
        keep_closest(padded, icp->nearest, distance, distance == icp->slack, icp->owner, icp->stale, icp->weight);
    }
    return (int32_t)ek_fit_count(icp->weight, padded, icp->wide);
}

/* Weigh the pairs of each target point: with c source points of variance 1 each and a target point that is the mean of n
 * such points, the sum of their residuals has the variance c + c^2 / n; so each weighs n / (n + c). */
static void share_noise(ek_icp *icp, const ek_index *target, size_t padded)
{
    uint32_t *const pairs = icp->owner;
    for (size_t i = 0; i < padded; i++) {
        pairs[icp->nearest[i]] = 0u;
    }
    for (size_t i = 0; i < padded; i++) {
        pairs[icp->nearest[i]] += icp->weight[i] > EK_R(0.0);
    }
    for (size_t i = 0; i < padded; i++) {
        const uint32_t slot = icp->weight[i] > EK_R(0.0) ? icp->nearest[i] : 0u;
        const ek_real independent = ek_index_support(target, slot);
        icp->share[i] = icp->weight[i] * independent / (independent + (ek_real)pairs[slot]);
    }
}

void ek_icp_measure_distances(ek_icp *icp, size_t padded)
{
    for (size_t i = 0; i < padded; i++) {
        icp->distance[i] = EK_SQRT(icp->slack[i]);
    }
}

/* Distances of the source points to the lines of their pairs. */
static void measure_across(ek_icp *icp, size_t padded)
{
    for (size_t i = 0; i < padded; i++) {
        const ek_real across = (icp->mx[i] - icp->tx[i]) * icp->nx[i] + (icp->my[i] - icp->ty[i]) * icp->ny[i];
        icp->across[i] = EK_FABS(across);
    }
}

ek_real ek_icp_compute_error(ek_icp *icp, size_t padded, int32_t pairs, const ek_icp_parameters *parameters)
{
    const ek_error_measure measure = parameters->error;
    const int lines = parameters->metric == EK_METRIC_LINE;
    if (lines) {
        measure_across(icp, padded);
    }
    const ek_real *const distance = lines ? icp->across : icp->distance;
    const ek_real total = ek_fit_sum(icp->weight, distance, padded, measure != EK_ERROR_MEAN, icp->wide) / (ek_real)pairs;
    return measure == EK_ERROR_RMSE ? EK_SQRT(total) : total;
}

ek_pose ek_icp_fit_step(ek_icp *icp, const ek_index *target, size_t padded, ek_pose pose, const ek_icp_parameters *parameters)
{
    const int shared = parameters->share_noise && parameters->metric == EK_METRIC_LINE;
    const ek_pairs pairs = {padded,  icp->mx,     icp->my, icp->tx, icp->ty,
                            icp->nx, icp->ny, icp->weight, shared ? icp->share : NULL, icp->wide};
    if (shared) {
        share_noise(icp, target, padded);
    }
    return parameters->metric == EK_METRIC_LINE ? ek_fit_lines(&pairs, parameters->cauchy, pose.x, pose.y)
                                                : ek_fit_points(&pairs, pose.x, pose.y);
}

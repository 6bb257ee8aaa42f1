#include "ek/fit.h"
#include "ek/wide.h"

#define RANK EK_R(1e-9) /* eigenvalues below this share of the largest count as zero */
#define SWEEPS 12       /* of Jacobi's method; a matrix of 3 x 3 needs about 5 */

static ek_real add_lanes(const ek_real lanes[EK_LANES])
{
    ek_real total = EK_R(0.0);
    for (size_t k = 0; k < EK_LANES; k++) {
        total += lanes[k];
    }
    return total;
}

EK_LOOP ek_real count_lanes(size_t padded, const ek_real *EK_RESTRICT weight)
{
    ek_real sums[EK_LANES] = {EK_R(0.0)};
    for (size_t i = 0; i < padded; i += EK_LANES) {
        for (size_t k = 0; k < EK_LANES; k++) {
            sums[k] += weight[i + k];
        }
    }
    return add_lanes(sums);
}

EK_COPIES(ek_real, count_lanes, (size_t padded, const ek_real *weight), { return count_lanes(padded, weight); })

ek_real ek_fit_count(const ek_real *weight, size_t padded, int wide)
{
    return EK_CALL(wide, count_lanes, (padded, weight));
}

EK_LOOP ek_real sum_lanes(size_t padded, int squared, const ek_real *EK_RESTRICT weight,
                          const ek_real *EK_RESTRICT distance)
{
    ek_real sums[EK_LANES] = {EK_R(0.0)};
    for (size_t i = 0; i < padded; i += EK_LANES) {
        for (size_t k = 0; k < EK_LANES; k++) {
            const ek_real once = weight[i + k] * distance[i + k];
            sums[k] += squared ? once * distance[i + k] : once;
        }
    }
    return add_lanes(sums);
}

EK_COPIES(ek_real, sum_lanes, (size_t padded, int squared, const ek_real *weight, const ek_real *distance),
          { return sum_lanes(padded, squared, weight, distance); })

ek_real ek_fit_sum(const ek_real *weight, const ek_real *distance, size_t padded, int squared, int wide)
{
    return EK_CALL(wide, sum_lanes, (padded, squared, weight, distance));
}

/* The motion with rotation theta (rad) that moves point (px, py) to (qx, qy). */
static ek_pose motion_about(ek_real px, ek_real py, ek_real qx, ek_real qy, ek_real theta)
{
    const ek_real c = EK_COS(theta), s = EK_SIN(theta);
    const ek_pose motion = {qx - c * px + s * py, qy - s * px - c * py, theta};
    return motion;
}

/* Sums of equations 3 and 4. They run in fixed lanes, so that the result does not depend on how a compiler vectorises. */
EK_LOOP void sum_points(size_t padded, ek_real ox, ek_real oy, const ek_real *EK_RESTRICT mx,
                        const ek_real *EK_RESTRICT my, const ek_real *EK_RESTRICT tx, const ek_real *EK_RESTRICT ty,
                        const ek_real *EK_RESTRICT weight, ek_real total[7])
{
    ek_real sums[7][EK_LANES] = {{EK_R(0.0)}};
    for (size_t i = 0; i < padded; i += EK_LANES) {
        for (size_t k = 0; k < EK_LANES; k++) {
            const ek_real w = weight[i + k];
            const ek_real x = w * (mx[i + k] - ox), y = w * (my[i + k] - oy);
            const ek_real u = tx[i + k] - ox, v = ty[i + k] - oy;
            sums[0][k] += w;
            sums[1][k] += x;
            sums[2][k] += y;
            sums[3][k] += w * u;
            sums[4][k] += w * v;
            sums[5][k] += x * v - y * u;
            sums[6][k] += x * u + y * v;
        }
    }
    for (size_t j = 0; j < 7u; j++) {
        total[j] = add_lanes(sums[j]);
    }
}

EK_LOOP void sum_points_of(const ek_pairs *p, ek_real ox, ek_real oy, ek_real total[7])
{
    sum_points(p->padded, ox, oy, p->x, p->y, p->tx, p->ty, p->weight, total);
}

EK_COPIES(void, sum_points_of, (const ek_pairs *p, ek_real ox, ek_real oy, ek_real total[7]),
          { sum_points_of(p, ox, oy, total); })

/* Equations 3 and 4, corrected. */
ek_pose ek_fit_points(const ek_pairs *pairs, ek_real ox, ek_real oy)
{
    ek_real total[7];
    EK_CALL(pairs->wide, sum_points_of, (pairs, ox, oy, total));
    const ek_real count = total[0], px = total[1] / count, py = total[2] / count;
    const ek_real qx = total[3] / count, qy = total[4] / count;
    const ek_real theta = EK_ATAN2(total[5] - count * (px * qy - py * qx), total[6] - count * (px * qx + py * qy));
    return motion_about(px + ox, py + oy, qx + ox, qy + oy, theta);
}

/* Rotate rows and columns p and q of the symmetric matrix so that its element p, q vanishes; rotate the vectors too. */
static void rotate(ek_real matrix[3][3], ek_real vectors[3][3], size_t p, size_t q)
{
    if (matrix[p][q] == EK_R(0.0)) {
        return;
    }
    const ek_real ratio = EK_R(0.5) * (matrix[q][q] - matrix[p][p]) / matrix[p][q];
    const ek_real root = EK_FABS(ratio) + EK_SQRT(ratio * ratio + EK_R(1.0));
    const ek_real t = (ratio < EK_R(0.0) ? EK_R(-1.0) : EK_R(1.0)) / root, c = EK_R(1.0) / EK_SQRT(t * t + EK_R(1.0));
    const ek_real s = t * c;
    for (size_t k = 0; k < 3u; k++) {
        const ek_real first = matrix[k][p], second = matrix[k][q];
        matrix[k][p] = c * first - s * second;
        matrix[k][q] = s * first + c * second;
    }
    for (size_t k = 0; k < 3u; k++) {
        const ek_real first = matrix[p][k], second = matrix[q][k];
        matrix[p][k] = c * first - s * second;
        matrix[q][k] = s * first + c * second;
        const ek_real left = vectors[k][p], right = vectors[k][q];
        vectors[k][p] = c * left - s * right;
        vectors[k][q] = s * left + c * right;
    }
    matrix[p][q] = matrix[q][p] = EK_R(0.0);
}

/* Shortest least-squares solution of a symmetric system: eigenvalues by Jacobi's method. */
static void solve(ek_real matrix[3][3], const ek_real right[3], ek_real solution[3])
{
    ek_real vectors[3][3] = {{EK_R(1.0), EK_R(0.0), EK_R(0.0)},
                             {EK_R(0.0), EK_R(1.0), EK_R(0.0)},
                             {EK_R(0.0), EK_R(0.0), EK_R(1.0)}};
    ek_real largest = EK_R(0.0);
    for (int sweep = 0; sweep < SWEEPS; sweep++) {
        rotate(matrix, vectors, 0u, 1u);
        rotate(matrix, vectors, 0u, 2u);
        rotate(matrix, vectors, 1u, 2u);
    }
    for (size_t j = 0; j < 3u; j++) {
        largest = EK_FABS(matrix[j][j]) > largest ? EK_FABS(matrix[j][j]) : largest;
        solution[j] = EK_R(0.0);
    }
    for (size_t j = 0; j < 3u; j++) {
        if (EK_FABS(matrix[j][j]) > RANK * largest) {
            const ek_real along = vectors[0][j] * right[0] + vectors[1][j] * right[1] + vectors[2][j] * right[2];
            for (size_t k = 0; k < 3u; k++) {
                solution[k] += along / matrix[j][j] * vectors[k][j];
            }
        }
    }
}

/* Weights, and coordinates of the source points relative to (ox, oy), summed. */
EK_LOOP void sum_sources(size_t padded, ek_real ox, ek_real oy, const ek_real *EK_RESTRICT mx,
                         const ek_real *EK_RESTRICT my, const ek_real *EK_RESTRICT weight, ek_real total[3])
{
    ek_real sums[3][EK_LANES] = {{EK_R(0.0)}};
    for (size_t i = 0; i < padded; i += EK_LANES) {
        for (size_t k = 0; k < EK_LANES; k++) {
            const ek_real w = weight[i + k];
            sums[0][k] += w;
            sums[1][k] += w * (mx[i + k] - ox);
            sums[2][k] += w * (my[i + k] - oy);
        }
    }
    for (size_t j = 0; j < 3u; j++) {
        total[j] = add_lanes(sums[j]);
    }
}

/* Sums of the normal equations about (cx, cy): the upper triangle of the matrix, then the right side. `sharp` (1/m): of
 * the Cauchy weight. */
EK_LOOP void sum_lines(size_t padded, ek_real cx, ek_real cy, ek_real sharp, const ek_real *EK_RESTRICT mx,
                       const ek_real *EK_RESTRICT my, const ek_real *EK_RESTRICT tx, const ek_real *EK_RESTRICT ty,
                       const ek_real *EK_RESTRICT nx, const ek_real *EK_RESTRICT ny,
                       const ek_real *EK_RESTRICT weight, ek_real total[9])
{
    ek_real sums[9][EK_LANES] = {{EK_R(0.0)}};
    for (size_t i = 0; i < padded; i += EK_LANES) {
        for (size_t k = 0; k < EK_LANES; k++) {
            const ek_real u = nx[i + k], v = ny[i + k];
            const ek_real distance = (tx[i + k] - mx[i + k]) * u + (ty[i + k] - my[i + k]) * v;
            const ek_real turn = (mx[i + k] - cx) * v - (my[i + k] - cy) * u;
            const ek_real scaled = sharp * distance, w = weight[i + k] / (EK_R(1.0) + scaled * scaled);
            sums[0][k] += w * u * u;
            sums[1][k] += w * u * v;
            sums[2][k] += w * v * v;
            sums[3][k] += w * u * turn;
            sums[4][k] += w * v * turn;
            sums[5][k] += w * turn * turn;
            sums[6][k] += w * u * distance;
            sums[7][k] += w * v * distance;
            sums[8][k] += w * turn * distance;
        }
    }
    for (size_t j = 0; j < 9u; j++) {
        total[j] = add_lanes(sums[j]);
    }
}

EK_LOOP void sum_sources_of(const ek_pairs *p, ek_real ox, ek_real oy, ek_real total[3])
{
    sum_sources(p->padded, ox, oy, p->x, p->y, p->weight, total);
}

EK_COPIES(void, sum_sources_of, (const ek_pairs *p, ek_real ox, ek_real oy, ek_real total[3]),
          { sum_sources_of(p, ox, oy, total); })

EK_LOOP void sum_lines_of(const ek_pairs *p, const ek_real *weight, ek_real cx, ek_real cy, ek_real sharp, ek_real total[9])
{
    sum_lines(p->padded, cx, cy, sharp, p->x, p->y, p->tx, p->ty, p->nx, p->ny, weight, total);
}

EK_COPIES(void, sum_lines_of,
          (const ek_pairs *p, const ek_real *weight, ek_real cx, ek_real cy, ek_real sharp, ek_real total[9]),
          { sum_lines_of(p, weight, cx, cy, sharp, total); })

ek_pose ek_fit_lines(const ek_pairs *pairs, ek_real cauchy, ek_real ox, ek_real oy)
{
    const ek_pairs *const p = pairs;
    const ek_real sharp = cauchy > EK_R(0.0) ? EK_R(1.0) / cauchy : EK_R(0.0);
    const ek_real *const weight = p->share ? p->share : p->weight;
    ek_real sources[3], total[9], move[3];
    EK_CALL(p->wide, sum_sources_of, (p, ox, oy, sources));
    const ek_real cx = sources[1] / sources[0] + ox, cy = sources[2] / sources[0] + oy;
    EK_CALL(p->wide, sum_lines_of, (p, weight, cx, cy, sharp, total));
    ek_real matrix[3][3] = {{total[0], total[1], total[3]}, {total[1], total[2], total[4]},
                            {total[3], total[4], total[5]}};
    solve(matrix, total + 6, move);
    return motion_about(cx, cy, cx + move[0], cy + move[1], move[2]);
}

/* The loops of icp.h over lanes: move, list, choose. */
#include "icp_parts.h"
#include "lanes.h"

/* Move points by a pose; compute distance to the target points and slack. The neighbour of a point cannot have changed
 * while distance + distance moved since the search < lower bound on all other distances at the search. Both sides are
 * squared, which saves a root. All pointers are parameters because compilers vectorise with `restrict` only on
 * parameters. */
EK_LOOP void move_points(size_t padded, ek_pose pose, ek_real limit, ek_real margin, const ek_real *EK_RESTRICT px,
                         const ek_real *EK_RESTRICT py, const ek_real *EK_RESTRICT tx, const ek_real *EK_RESTRICT ty,
                         const ek_real *EK_RESTRICT ax, const ek_real *EK_RESTRICT ay,
                         const ek_real *EK_RESTRICT others, ek_real *EK_RESTRICT mx, ek_real *EK_RESTRICT my,
                         ek_real *EK_RESTRICT distance, ek_real *EK_RESTRICT slack)
{
    const ek_real c = EK_COS(pose.theta), s = EK_SIN(pose.theta), x0 = pose.x, y0 = pose.y;
    for (size_t i = 0; i < padded; i++) {
        const ek_real x = c * px[i] - s * py[i] + x0, y = s * px[i] + c * py[i] + y0;
        const ek_real dx = x - tx[i], dy = y - ty[i], wx = x - ax[i], wy = y - ay[i];
        const ek_real to = EK_SQRT(dx * dx + dy * dy), within = to < limit ? to : limit;
        const ek_real left = others[i] - within - margin, room = left > EK_R(0.0) ? left : EK_R(0.0);
        mx[i] = x;
        my[i] = y;
        distance[i] = to;
        slack[i] = EK_ICP_ROUNDED_DOWN * room * room - (wx * wx + wy * wy);
    }
}

EK_LOOP void move_of(const ek_icp *p, size_t padded, ek_pose pose, ek_real limit, ek_real margin)
{
    move_points(padded, pose, limit, margin, p->px, p->py, p->tx, p->ty, p->ax, p->ay, p->others, p->mx, p->my,
                p->distance, p->slack);
}

EK_COPIES(void, move_of, (const ek_icp *p, size_t padded, ek_pose pose, ek_real limit, ek_real margin),
          { move_of(p, padded, pose, limit, margin); })

void ek_icp_move(const ek_icp *p, size_t padded, ek_pose pose, ek_real limit, ek_real margin)
{
    EK_CALL(p->wide, move_of, (p, padded, pose, limit, margin));
}

/* Choose the nearest of the candidates of each point, of equals the first, and give it weight 1 if the square of its
 * distance is below `reach` (m^2), else 0. Returns how often two were equally near if `ties` is 1, else 0. */
EK_LOOP ek_real choose_candidates(size_t padded, ek_real reach, int ties, size_t abreast, const ek_real *EK_RESTRICT mx,
                                  const ek_real *EK_RESTRICT my, const ek_real *EK_RESTRICT cx,
                                  const ek_real *EK_RESTRICT cy, ek_real *EK_RESTRICT tx, ek_real *EK_RESTRICT ty,
                                  ek_real *EK_RESTRICT squared, ek_real *EK_RESTRICT choice,
                                  ek_real *EK_RESTRICT weight)
{
    ek_real tied[EK_LANES] = {EK_R(0.0)}, total = EK_R(0.0);
    for (size_t i = 0; i < padded; i += abreast) {
        for (size_t lane = 0; lane < abreast; lane++) {
            const size_t first = EK_BLOCK * i + lane;
            const ek_real x = mx[i + lane], y = my[i + lane];
            ek_real u = cx[first], v = cy[first], best = (x - u) * (x - u) + (y - v) * (y - v), which = EK_R(0.0);
            for (size_t k = 1; k < EK_BLOCK; k++) {
                const ek_real a = cx[first + abreast * k], b = cy[first + abreast * k];
                const ek_real square = (x - a) * (x - a) + (y - b) * (y - b);
                const int closer = square < best;
                if (ties) {
                    tied[lane] += square == best ? EK_R(1.0) : EK_R(0.0);
                }
                u = closer ? a : u;
                v = closer ? b : v;
                which = closer ? (ek_real)k : which;
                best = closer ? square : best;
            }
            tx[i + lane] = u;
            ty[i + lane] = v;
            squared[i + lane] = best;
            choice[i + lane] = which;
            weight[i + lane] = best < reach ? EK_R(1.0) : EK_R(0.0);
        }
    }
    for (size_t lane = 0; lane < EK_LANES; lane++) {
        total += tied[lane];
    }
    return total;
}

/* Constant `ties` and `abreast` only: a loop that tests them is not made into vectors. */
#define CHOOSE(ties, abreast) \
    choose_candidates(padded, reach, ties, abreast, p->mx, p->my, p->cx, p->cy, p->tx, p->ty, p->slack, p->choice, p->weight)

EK_LOOP ek_real choose(const ek_icp *p, size_t padded, ek_real reach)
{
    return CHOOSE(0, EK_ICP_ABREAST);
}

EK_LOOP ek_real choose_tied(const ek_icp *p, size_t padded, ek_real reach)
{
    return CHOOSE(1, EK_ICP_ABREAST);
}

#if EK_COPIED
EK_WIDE static ek_real choose_avx2(const ek_icp *p, size_t padded, ek_real reach) { return CHOOSE(0, EK_ICP_ABREAST); }
EK_WIDE static ek_real choose_tied_avx2(const ek_icp *p, size_t padded, ek_real reach) { return CHOOSE(1, EK_ICP_ABREAST); }
EK_WIDEST static ek_real choose_avx512(const ek_icp *p, size_t padded, ek_real reach) { return CHOOSE(0, EK_LANES); }
EK_WIDEST static ek_real choose_tied_avx512(const ek_icp *p, size_t padded, ek_real reach) { return CHOOSE(1, EK_LANES); }
#endif

ek_real ek_icp_choose(const ek_icp *p, size_t padded, ek_real reach, int ties)
{
    return ties ? EK_CALL(p->wide, choose_tied, (p, padded, reach)) : EK_CALL(p->wide, choose, (p, padded, reach));
}

void ek_icp_choose_lowest(const ek_icp *icp, const ek_index *target, size_t count)
{
    const size_t abreast = ek_icp_abreast(icp);
    for (size_t i = 0; i < count; i++) {
        const size_t first = ek_icp_first_candidate(i, abreast);
        size_t chosen = (size_t)(int32_t)icp->choice[i];
        for (size_t k = 0; k < EK_BLOCK && icp->weight[i] > EK_R(0.0); k++) {
            const ek_real a = icp->cx[first + abreast * k], b = icp->cy[first + abreast * k];
            const ek_real x = icp->mx[i] - a, y = icp->my[i] - b;
            const uint32_t *const slots = icp->slots + EK_BLOCK * i;
            if (x * x + y * y == icp->slack[i] && target->id[slots[k]] < target->id[slots[chosen]]) {
                chosen = k;
                icp->tx[i] = a;
                icp->ty[i] = b;
            }
        }
        icp->choice[i] = (ek_real)chosen;
    }
}

/* List the points whose neighbour may have changed; returns their number. */
EK_LOOP uint32_t list_lacking(size_t padded, const ek_real *EK_RESTRICT slack, uint32_t *EK_RESTRICT stale)
{
    uint32_t searches = 0u;
    for (uint32_t i = 0; i < padded; i += EK_LANES) {
        for (uint32_t lane = 0; lane < EK_LANES; lane++) {
            stale[searches] = i + lane;
            searches += slack[i + lane] > EK_R(0.0) ? 0u : 1u;
        }
    }
    return searches;
}

#if EK_COPIED
#define list_lacking_avx2 list_lacking
EK_WIDEST static uint32_t list_lacking_avx512(size_t padded, const ek_real *slack, uint32_t *stale)
{
    uint32_t searches = 0u;
    for (uint32_t i = 0; i < padded; i += EK_LANES) {
        const ek_lanes zero = EK_LANES_OF(setzero)(), now = EK_LANES_OF(loadu)(slack + i);
        searches = ek_append_lanes(stale, searches, i, (__mmask8)~EK_BELOW(zero, now));
    }
    return searches;
}
#endif

uint32_t ek_icp_list_stale(const ek_icp *icp, size_t padded)
{
    return EK_CALL(icp->wide, list_lacking, (padded, icp->slack, icp->stale));
}

/* Take the chosen candidate of each point as its neighbour. */
static void take_slots(size_t padded, const uint32_t *EK_RESTRICT slots, const ek_real *EK_RESTRICT choice,
                       uint32_t *EK_RESTRICT nearest)
{
    for (size_t i = 0; i < padded; i += EK_LANES) {
        for (size_t k = i; k < i + EK_LANES; k++) {
            nearest[k] = slots[EK_BLOCK * k + (size_t)(int32_t)choice[k]];
        }
    }
}

void ek_icp_take_slots(const ek_icp *icp, size_t padded)
{
    take_slots(padded, icp->slots, icp->choice, icp->nearest);
}

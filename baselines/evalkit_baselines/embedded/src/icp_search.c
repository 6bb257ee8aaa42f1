/* The searches of icp.h: for neighbours one by one, and for candidates from a table or in groups. */
#include "ek/nearby.h"
#include "ek/normals.h"
#include "icp_parts.h"

#include <string.h>

#define FIRST_LOOK EK_R(0.75) /* cells: half width of the first search without a known neighbour */
#define BEYOND EK_R(0.25)     /* cells: searched beyond the last neighbour; saves later searches */
#define ALONE EK_R(1.0)       /* cells: searched beyond the limit where no neighbour is within it; likewise */
#define SHARE EK_R(2.0) /* of the squares around each place that the one around a group may have */
#define AHEAD 32u /* searches from the prefetch of a block to its use */
#define CACHE_LINE 64u

/* Half width (m) of the first look for the neighbour of a point. */
static ek_real first_look(const ek_icp *icp, const ek_index *target, uint32_t i, ek_real limit)
{
    const ek_real known = icp->distance[i] + BEYOND * target->cells.cell;
    return icp->distance[i] < limit ? known : FIRST_LOOK * target->cells.cell;
}

uint32_t ek_icp_search(ek_icp *icp, const ek_index *target, const ek_real *normals, size_t padded, ek_real limit)
{
    const uint32_t searches = ek_icp_list_stale(icp, padded);
    ek_real first = target->cells.cell;
    for (uint32_t k = 0; k < searches; k++) {
        const uint32_t i = icp->stale[k];
        const ek_real look = first_look(icp, target, i, limit);
        const ek_neighbour answer = ek_index_nearest(target, icp->mx[i], icp->my[i], limit, look);
        const int found = answer.slot != EK_NONE;
        icp->tx[i] = found ? target->xy[2u * answer.slot] : EK_FAR;
        icp->ty[i] = found ? target->xy[2u * answer.slot + 1u] : EK_FAR;
        icp->distance[i] = found ? answer.distance : EK_FAR;
        icp->nearest[i] = found ? answer.slot : (uint32_t)icp->targets;
        if (found && normals && target->deferred) {
            ek_normals_ensure(target, answer.slot, &first);
        }
        if (normals) {
            icp->nx[i] = icp->ny[i] = EK_R(0.0);
        }
        if (normals && found) {
            ek_icp_take_line(icp, target, normals, i, answer.slot);
        }
        icp->ax[i] = icp->mx[i];
        icp->ay[i] = icp->my[i];
        icp->others[i] = answer.others;
    }
    return searches;
}

/* Take the points of a block of the table as the candidates of a point. */
static inline void load_block(ek_icp *icp, const ek_block *block, uint32_t i)
{
    const size_t abreast = ek_icp_abreast(icp), first = ek_icp_first_candidate(i, abreast);
    ek_real *const EK_RESTRICT x = icp->cx + first, *const EK_RESTRICT y = icp->cy + first;
    for (size_t k = 0; k < EK_BLOCK; k++) {
        x[abreast * k] = block->x[k];
        y[abreast * k] = block->y[k];
    }
    memcpy(icp->slots + EK_BLOCK * i, block->slot, sizeof block->slot);
    icp->ax[i] = block->centre_x;
    icp->ay[i] = block->centre_y;
    icp->others[i] = block->others;
}

/* Take the neighbour that the index finds as the only candidate of a point; `look`: half width (m) of the first look. */
static void load_neighbour(ek_icp *icp, const ek_index *target, uint32_t i, ek_real limit, ek_real look)
{
    const ek_neighbour answer = ek_index_nearest(target, icp->mx[i], icp->my[i], limit, look);
    const int found = answer.slot != EK_NONE;
    ek_block only;
    for (size_t k = 0; k < EK_BLOCK; k++) {
        only.x[k] = found && k == 0u ? target->xy[2u * answer.slot] : ek_icp_far_away(k);
        only.y[k] = found && k == 0u ? target->xy[2u * answer.slot + 1u] : ek_icp_far_away(k);
        only.slot[k] = found && k == 0u ? answer.slot : 0u;
    }
    only.centre_x = icp->mx[i];
    only.centre_y = icp->my[i];
    only.others = answer.others;
    load_block(icp, &only, i);
}

/* Prefetch a block: each of its cache lines, wherever it begins. */
static inline void prefetch_block(const ek_block *block)
{
    const char *const bytes = (const char *)block;
    for (size_t at = 0; at < sizeof *block; at += CACHE_LINE) {
        EK_PREFETCH(bytes + at);
    }
    EK_PREFETCH(bytes + sizeof *block - 1u);
}

/* Load the candidates of the points whose neighbour may have changed; returns the number of searches. */
static uint32_t load_from_table(ek_icp *icp, const ek_index *target, size_t padded, ek_real limit)
{
    ek_table *const table = target->table;
    const uint32_t searches = ek_icp_list_stale(icp, padded);
    ek_table_locate(table, target, icp->mx, icp->my, icp->stale, searches, icp->pair_source);
    for (uint32_t k = 0; k < AHEAD && k < searches; k++) {
        prefetch_block(table->block + icp->pair_source[k]);
    }
    for (uint32_t k = 0; k < searches; k++) {
        const uint32_t i = icp->stale[k], at = icp->pair_source[k];
        prefetch_block(table->block + (k + AHEAD < searches ? icp->pair_source[k + AHEAD] : 0u));
        const ek_block *block = table->block + at;
        if (!block->complete) {
            block = ek_table_block(table, target, at, icp->mx[i], icp->my[i], limit);
        }
        if (block) {
            load_block(icp, block, i);
        } else {
            load_neighbour(icp, target, i, limit, first_look(icp, target, i, limit));
        }
    }
    return searches;
}

/* Take the points that were found for one place of a group as the candidates of a point. */
static inline void load_nearby(ek_icp *icp, const ek_index *target, const ek_nearby *found, uint32_t lane, uint32_t i)
{
    const size_t abreast = ek_icp_abreast(icp), first = ek_icp_first_candidate(i, abreast);
    ek_real *const EK_RESTRICT x = icp->cx + first, *const EK_RESTRICT y = icp->cy + first;
    for (size_t k = 0; k < EK_BLOCK; k++) {
        const uint32_t slot = found->slot[k][lane];
        const int none = slot == EK_NONE;
        x[abreast * k] = none ? ek_icp_far_away(k) : target->xy[2u * slot];
        y[abreast * k] = none ? ek_icp_far_away(k) : target->xy[2u * slot + 1u];
        icp->slots[EK_BLOCK * i + k] = none ? 0u : slot;
    }
    icp->ax[i] = icp->mx[i];
    icp->ay[i] = icp->my[i];
    icp->others[i] = found->others[lane];
}

/* Places that are searched together. */
typedef struct {
    uint32_t size;
    ek_real x[EK_GROUP], y[EK_GROUP], radius; /* m */
} group;

/* Gather the first of `count` points and those after it as long as one look for all of them is cheaper than a look for
 * each, by the areas looked at. */
static void gather_group(const ek_icp *icp, const ek_index *target, const uint32_t *points, uint32_t count, ek_real limit,
                         group *places)
{
    const ek_real cell = target->cells.cell;
    ek_real left = EK_FAR, right = -EK_FAR, bottom = EK_FAR, top = -EK_FAR;
    places->radius = EK_R(0.0);
    places->size = 0u;
    for (uint32_t k = 0; k < EK_GROUP && k < count; k++) {
        const ek_real x = icp->mx[points[k]], y = icp->my[points[k]], look = first_look(icp, target, points[k], limit);
        left = x < left ? x : left;
        right = x > right ? x : right;
        bottom = y < bottom ? y : bottom;
        top = y > top ? y : top;
        const ek_real radius = look > places->radius ? look : places->radius, beside = EK_R(2.0) * radius + cell;
        if (k && (right - left + beside) * (top - bottom + beside) > SHARE * (ek_real)(k + 1u) * beside * beside) {
            break;
        }
        places->radius = radius;
        places->x[k] = x;
        places->y[k] = y;
        places->size++;
    }
    for (uint32_t lane = places->size; lane < EK_GROUP; lane++) {
        places->x[lane] = places->x[0];
        places->y[lane] = places->y[0];
    }
}

/* Search for the first of `count` points and those after it that lie beside it; returns how many these are. */
static uint32_t load_group(ek_icp *icp, const ek_index *target, const uint32_t *points, uint32_t count, ek_real limit)
{
    group places;
    ek_nearby found;
    gather_group(icp, target, points, count, limit, &places);
    const int near = ek_index_nearby(target, places.x, places.y, places.radius, icp->wide, &found);
    for (uint32_t lane = 0; lane < places.size; lane++) {
        const uint32_t i = points[lane];
        const int some = near && found.nearest[lane] < limit;
        const ek_real within = some ? found.nearest[lane] : limit;
        if (near && within < found.others[lane]) {
            load_nearby(icp, target, &found, lane, i);
        } else { /* one look that suffices: smaller ones would find what the group has found */
            const ek_real enough = within + (some ? BEYOND : ALONE) * target->cells.cell;
            load_neighbour(icp, target, i, limit, near ? enough : first_look(icp, target, i, limit));
        }
    }
    return places.size;
}

/* As load_from_table, without a table: search the index for groups of points. */
static uint32_t load_groups(ek_icp *icp, const ek_index *target, size_t padded, ek_real limit)
{
    const uint32_t searches = ek_icp_list_stale(icp, padded);
    for (uint32_t done = 0; done < searches;) {
        done += load_group(icp, target, icp->stale + done, searches - done, limit);
    }
    return searches;
}

uint32_t ek_icp_load_candidates(ek_icp *icp, const ek_index *target, size_t padded, ek_real limit)
{
    return EK_GROUPED && !target->table ? load_groups(icp, target, padded, limit) : load_from_table(icp, target, padded, limit);
}

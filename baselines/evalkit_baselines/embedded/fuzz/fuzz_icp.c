/* Arbitrary clouds: a registration is finite, repeatable, uses true nearest neighbours and is the same with a table of
 * them and with places searched one by one, or is refused and changes nothing; normals are unit vectors. */
#include "ek/icp.h"
#include "ek/normals.h"
#include "ek/table.h"
#include "input.h"

#define MAX_COUNT 32u
#define NO_LIMIT EK_R(1e12) /* m */

typedef struct {
    const ek_real *source, *target;
    size_t sources, targets;
} clouds;

/* Check the pairs of the trace: valid indices, each source point once. */
static void traced(void *context, const ek_icp_iteration *now)
{
    const clouds *const known = (const clouds *)context;
    HOLDS(now->iteration >= 1 && now->inliers >= 2 && (size_t)now->inliers <= known->sources);
    for (int32_t k = 0; k < now->inliers; k++) {
        HOLDS(now->source[k] < known->sources && now->target[k] < known->targets);
        HOLDS(k == 0 || now->source[k] > now->source[k - 1]);
    }
}

/* Check a search of the index against brute force. */
static void nearest(const ek_index *index, const clouds *known, ek_real x, ek_real y, ek_real limit, ek_real radius)
{
    const ek_neighbour found = ek_index_nearest(index, x, y, limit, radius);
    ek_real least = EK_FAR;
    for (size_t i = 0; i < known->targets; i++) {
        const ek_real dx = known->target[2u * i] - x, dy = known->target[2u * i + 1u] - y;
        const ek_real distance = EK_SQRT(dx * dx + dy * dy);
        least = distance < least ? distance : least;
    }
    if (found.slot == EK_NONE) {
        HOLDS(least >= limit);
    } else {
        HOLDS(found.slot < index->count && index->id[found.slot] < known->targets);
        HOLDS(found.distance == least && least < limit);
    }
}

/* Normals have length 1, or are (0, 0) with a radius. */
static void compute_normals(ek_index *index, ek_input *input, ek_real *normals)
{
    const size_t neighbours = take_byte(input) % (EK_MAX_NEIGHBOURS + 2u);
    const ek_real radius = take_byte(input) % 2u ? EK_FAR : take_real(input);
    if (ek_normals_compute(index, neighbours, radius, normals) != EK_OK) {
        return;
    }
    index->normals = normals;
    for (size_t i = 0; i < index->count; i++) {
        const ek_real x = normals[2u * i], y = normals[2u * i + 1u], length = EK_SQRT(x * x + y * y);
        HOLDS(EK_FABS(length - EK_R(1.0)) < EK_R(1e-5) || (radius < EK_FAR && x == EK_R(0.0) && y == EK_R(0.0)));
    }
}

/* A table changes no result, whether it is empty, filling or full. */
static void with_a_table(ek_icp *icp, ek_index *index, const clouds *known, ek_pose guess,
                         const ek_icp_parameters *parameters, const ek_match *expected)
{
    static ek_table table;
    ek_arena measured = ek_arena_make(NULL, 0u);
    HOLDS(ek_table_init(&table, &measured, index, 12u, 24u) == EK_OK && index->table == NULL);
    ek_arena arena = memory_for(&measured);
    HOLDS(ek_table_init(&table, &arena, index, 12u, 24u) == EK_OK && index->table == &table);
    for (int turn = 0; turn < 5; turn++) {
        ek_match found;
        HOLDS(ek_icp_register(icp, index, known->source, known->sources, guess, parameters, NULL, NULL, &found) == EK_OK);
        HOLDS(same_pose(found.target_from_source, expected->target_from_source));
        HOLDS(found.inliers == expected->inliers && found.iterations == expected->iterations);
    }
    index->table = NULL;
    free(arena.memory);
}

/* Searching places one by one or in groups changes no result. */
static void one_by_one(ek_icp *icp, const ek_index *index, const clouds *known, ek_pose guess,
                       const ek_icp_parameters *parameters, const ek_match *expected)
{
    const int grouped = icp->grouped;
    ek_match found;
    icp->grouped = 0;
    HOLDS(ek_icp_register(icp, index, known->source, known->sources, guess, parameters, NULL, NULL, &found) == EK_OK);
    HOLDS(same_pose(found.target_from_source, expected->target_from_source));
    HOLDS(found.inliers == expected->inliers && found.iterations == expected->iterations);
    icp->grouped = grouped;
}

static void ask(ek_icp *icp, ek_index *index, const clouds *known, ek_input *input)
{
    ek_icp_parameters parameters = ek_icp_default();
    const uint8_t flags = take_byte(input);
    parameters.max_iterations = 1 + flags % 8u;
    parameters.one_to_one = flags >> 3 & 1u;
    parameters.error_before = flags >> 4 & 1u;
    parameters.error = (ek_error_measure)(flags >> 5 & 3u); /* 3 is invalid */
    parameters.min_pairs = take_byte(input) % 8;
    parameters.epsilon = take_real(input);
    parameters.max_correspondence = take_real(input);
    const uint8_t metric = take_byte(input);
    parameters.metric = (ek_metric)(metric % 3u); /* 2 is invalid */
    parameters.share_noise = metric >> 7;
    parameters.cauchy = parameters.metric ? take_real(input) : EK_R(0.0);
    const ek_pose guess = take_pose(input);
    ek_real normals[2u * MAX_COUNT], seen_from[2u * MAX_COUNT];
    uint32_t support[MAX_COUNT];
    compute_normals(index, input, normals);
    for (size_t i = 0; i < known->targets && i < MAX_COUNT; i++) {
        support[i] = 1u + take_byte(input);
        seen_from[2u * i] = ((ek_real)take_byte(input) - EK_R(128.0)) / EK_R(128.0);
        seen_from[2u * i + 1u] = EK_R(1.0) - EK_FABS(seen_from[2u * i]);
    }
    index->support = metric & 64u ? support : NULL;
    index->seen_from = metric & 32u ? seen_from : NULL;
    parameters.origin_x = metric & 16u ? take_real(input) : EK_R(0.0);
    parameters.origin_y = metric & 16u ? take_real(input) : EK_R(0.0);
    ek_match match, again;
    memset(&match, 0xA5, sizeof match);
    again = match;
    const ek_status status = ek_icp_register(icp, index, known->source, known->sources, guess, &parameters, traced,
                                             (void *)(uintptr_t)known, &match);
    if (status != EK_OK) {
        HOLDS(memcmp(&match, &again, sizeof match) == 0);
        return;
    }
    HOLDS(ek_se2_is_finite(match.target_from_source) && (match.converged == 0 || match.converged == 1));
    HOLDS(match.iterations >= 0 && match.iterations <= parameters.max_iterations);
    HOLDS(match.inliers >= 0 && (size_t)match.inliers <= known->sources);
    HOLDS(match.error >= EK_R(0.0) || match.inliers < parameters.min_pairs);
    HOLDS(ek_icp_register(icp, index, known->source, known->sources, guess, &parameters, NULL, NULL, &again) == EK_OK);
    HOLDS(same_pose(match.target_from_source, again.target_from_source) && match.inliers == again.inliers);
    with_a_table(icp, index, known, guess, &parameters, &match);
    one_by_one(icp, index, known, guess, &parameters, &match);
    const int limited = parameters.max_correspondence > EK_R(0.0) && parameters.max_correspondence < NO_LIMIT;
    const ek_real limit = limited ? parameters.max_correspondence : NO_LIMIT;
    for (size_t i = 0; i < known->sources; i++) {
        nearest(index, known, known->source[2u * i], known->source[2u * i + 1u], limit, EK_R(0.1) * (ek_real)(i + 1u));
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    ek_input input = {bytes, size};
    ek_icp icp;
    ek_index index;
    ek_arena measured = ek_arena_make(NULL, 0u);
    const size_t cells = 1u + take_byte(&input);
    HOLDS(ek_icp_init(&icp, &measured, MAX_COUNT, MAX_COUNT) == EK_OK && ek_icp_init_lines(&icp, &measured) == EK_OK);
    HOLDS(ek_icp_init_table(&icp, &measured) == EK_OK);
    HOLDS(ek_index_init(&index, &measured, MAX_COUNT, cells) == EK_OK);
    ek_arena arena = memory_for(&measured);
    HOLDS(ek_icp_init(&icp, &arena, MAX_COUNT, MAX_COUNT) == EK_OK && ek_icp_init_lines(&icp, &arena) == EK_OK);
    HOLDS(ek_icp_init_table(&icp, &arena) == EK_OK);
    HOLDS(ek_index_init(&index, &arena, MAX_COUNT, cells) == EK_OK && ek_arena_check(&arena) == EK_OK);
    for (int rounds = 0; rounds < 2 && input.left; rounds++) {
        clouds known;
        known.targets = take_byte(&input) % (MAX_COUNT + 2u);
        known.sources = take_byte(&input) % (MAX_COUNT + 2u);
        ek_real *const target = take_reals(&input, 2u * known.targets), *const source =
                                                                            take_reals(&input, 2u * known.sources);
        known.target = target;
        known.source = source;
        const ek_status built = ek_index_build(&index, target, known.targets);
        HOLDS(built == EK_OK ? index.count == known.targets : index.count == 0u);
        known.targets = index.count;
        ask(&icp, &index, &known, &input);
        free(target);
        free(source);
    }
    free(arena.memory);
    return 0;
}

/* Every registration of up to three source with up to three target points out of seven, from three guesses, at all
 * corners of the parameters: each iteration is checked against brute force. With EK_SANITIZE also for memory and
 * undefined behaviour. */
#include "check.h"
#include "ek/icp.h"

#define PLACES 7u
#define MOST 3u
#define LIMIT EK_R(0.3) /* m */
#define SLACK (10.0 * TOLERANCE)

/* The origin, a point at the limit from it, neighbours at 1 m, one far and one nearly equal. */
static const ek_real places[PLACES][2] = {{EK_R(0.0), EK_R(0.0)}, {LIMIT, EK_R(0.0)},        {EK_R(1.0), EK_R(0.0)},
                                          {EK_R(0.0), EK_R(1.0)}, {EK_R(-1.0), EK_R(1e-3)}, {EK_R(50.0), EK_R(-50.0)},
                                          {EK_R(1e-3), EK_R(0.0)}};

typedef struct {
    ek_real xy[2u * MOST];
    size_t count;
} cloud;

typedef struct {
    const cloud *source, *target;
    const ek_icp_parameters *parameters;
    ek_pose pose;    /* before the iteration */
    double error, previous; /* of the last two iterations, in the unit of the stop rule */
    int iterations, inliers;
} history;

static unsigned long long registrations;

/* The cloud of a number: its digits to the base PLACES + 1 are places, 0 is none. 0 if the digits do not descend. */
static int cloud_of(unsigned number, cloud *made)
{
    unsigned last = PLACES;
    for (made->count = 0; number; number /= PLACES + 1u) {
        const unsigned digit = number % (PLACES + 1u);
        if (digit == 0u || digit > last) {
            return 0;
        }
        last = digit;
        made->xy[2u * made->count] = places[digit - 1u][0];
        made->xy[2u * made->count + 1u] = places[digit - 1u][1];
        made->count++;
    }
    return 1;
}

static void place(const ek_pose *pose, const ek_real *from, double to[2])
{
    const double c = cos((double)pose->theta), s = sin((double)pose->theta);
    to[0] = c * (double)from[0] - s * (double)from[1] + (double)pose->x;
    to[1] = s * (double)from[0] + c * (double)from[1] + (double)pose->y;
}

static double distance_between(const double a[2], const ek_real *b)
{
    return hypot(a[0] - (double)b[0], a[1] - (double)b[1]);
}

/* The pairs are the nearest neighbours within the limit; one-to-one keeps the closest of several. */
static void check_pairs(const history *known, const ek_icp_iteration *now)
{
    const double limit = known->parameters->max_correspondence > EK_R(0.0) ? (double)LIMIT : 1e30;
    double least[MOST], taken[MOST] = {1e30, 1e30, 1e30};
    int32_t pair_of[MOST] = {-1, -1, -1};
    int used[MOST] = {0, 0, 0};
    for (int32_t k = 0; k < now->inliers; k++) {
        CHECK(now->source[k] < known->source->count && now->target[k] < known->target->count);
        CHECK(k == 0 || now->source[k] > now->source[k - 1]);
        pair_of[now->source[k]] = k;
        used[now->target[k]]++;
    }
    for (size_t i = 0; i < known->source->count; i++) {
        double moved[2];
        place(&known->pose, known->source->xy + 2u * i, moved);
        least[i] = 1e30;
        for (size_t j = 0; j < known->target->count; j++) {
            const double distance = distance_between(moved, known->target->xy + 2u * j);
            least[i] = distance < least[i] ? distance : least[i];
        }
        if (pair_of[i] >= 0) {
            const uint32_t j = now->target[pair_of[i]];
            taken[j] = distance_between(moved, known->target->xy + 2u * j);
            CHECK_NEAR(taken[j], least[i], SLACK);
            CHECK(least[i] < limit + SLACK);
        }
    }
    for (size_t i = 0; i < known->source->count; i++) {
        if (pair_of[i] < 0 && least[i] < limit - SLACK) { /* dropped: another point holds a neighbour at this distance */
            int held = 0;
            double moved[2];
            place(&known->pose, known->source->xy + 2u * i, moved);
            for (size_t j = 0; j < known->target->count; j++) {
                held |= distance_between(moved, known->target->xy + 2u * j) < least[i] + SLACK && used[j] &&
                        taken[j] < least[i] + SLACK;
            }
            CHECK(known->parameters->one_to_one && held);
        }
    }
    for (size_t j = 0; known->parameters->one_to_one && j < MOST; j++) {
        CHECK(used[j] <= 1);
    }
}

/* The pose after the step is the least-squares one (equations 5 to 8), and the error is that of the definition. */
static void check_step(const history *known, const ek_icp_iteration *now)
{
    const ek_pose *const scored = known->parameters->error_before ? &known->pose : &now->target_from_source;
    double sum[2] = {0.0, 0.0}, centre[2] = {0.0, 0.0}, error = 0.0, cross = 0.0, dot = 0.0;
    double moved[MOST][2], scale = 1.0;
    for (int32_t k = 0; k < now->inliers; k++) {
        const ek_real *const to = known->target->xy + 2u * now->target[k];
        const ek_real *const from = known->source->xy + 2u * now->source[k];
        double before[2];
        scale = fmax(scale, hypot((double)from[0], (double)from[1]) + hypot((double)to[0], (double)to[1]));
        place(&now->target_from_source, from, moved[k]);
        place(scored, from, before);
        const double distance = distance_between(before, to);
        error += known->parameters->error == EK_ERROR_MEAN ? distance : distance * distance;
        for (int axis = 0; axis < 2; axis++) {
            sum[axis] += moved[k][axis] - (double)to[axis];
            centre[axis] += (double)to[axis] / now->inliers;
        }
    }
    for (int32_t k = 0; k < now->inliers; k++) {
        const ek_real *const to = known->target->xy + 2u * now->target[k];
        const double ax = moved[k][0] - centre[0], ay = moved[k][1] - centre[1];
        const double bx = (double)to[0] - centre[0], by = (double)to[1] - centre[1];
        cross += ax * by - ay * bx;
        dot += ax * bx + ay * by;
    }
    CHECK_NEAR(sum[0] / now->inliers, 0.0, SLACK * scale);
    CHECK_NEAR(sum[1] / now->inliers, 0.0, SLACK * scale);
    CHECK_NEAR(cross, 0.0, SLACK * scale * scale);
    CHECK(dot >= -SLACK * scale * scale);
    error /= now->inliers;
    if (known->parameters->error == EK_ERROR_RMSE) {
        CHECK_NEAR((double)now->error * (double)now->error, error, SLACK * scale * scale);
    } else {
        CHECK_NEAR(now->error, error, SLACK * scale * scale);
    }
}

static void traced(void *context, const ek_icp_iteration *now)
{
    history *const known = (history *)context;
    known->iterations++;
    CHECK(now->iteration == known->iterations);
    CHECK(now->inliers >= known->parameters->min_pairs && (size_t)now->inliers <= known->source->count);
    check_pairs(known, now);
    check_step(known, now);
    known->pose = now->target_from_source;
    known->previous = known->error;
    known->error = (double)now->error;
    known->inliers = now->inliers;
}

static void register_once(ek_icp *icp, const ek_index *index, const cloud *source, const cloud *target, ek_pose guess,
                          const ek_icp_parameters *parameters)
{
    history known = {source, target, parameters, guess, -1.0, -1.0, 0, 0};
    ek_match match, again;
    memset(&match, 0, sizeof match);
    memset(&again, 0, sizeof again);
    CHECK(ek_icp_register(icp, index, source->xy, source->count, guess, parameters, traced, &known, &match) == EK_OK);
    CHECK(ek_icp_register(icp, index, source->xy, source->count, guess, parameters, NULL, NULL, &again) == EK_OK);
    CHECK(match.target_from_source.x == again.target_from_source.x &&
          match.target_from_source.y == again.target_from_source.y &&
          match.target_from_source.theta == again.target_from_source.theta && match.iterations == again.iterations);
    CHECK(match.iterations >= known.iterations && match.iterations <= parameters->max_iterations);
    const ek_pose last = match.inliers < parameters->min_pairs ? guess : known.pose; /* with too few pairs: the guess */
    CHECK_NEAR(match.target_from_source.x, last.x, SLACK);
    CHECK_NEAR(match.target_from_source.y, last.y, SLACK);
    if (match.converged) {
        CHECK(known.iterations >= 2 && fabs(known.error - known.previous) < (double)parameters->epsilon + SLACK);
        CHECK(match.inliers == known.inliers);
    } else { /* out of iterations, or of pairs */
        CHECK(known.iterations == parameters->max_iterations || match.inliers < parameters->min_pairs);
    }
    registrations++;
}

static ek_icp_parameters corner(unsigned bits)
{
    ek_icp_parameters made = ek_icp_default();
    made.max_iterations = bits & 1u ? 4 : 1;
    made.min_pairs = bits & 2u ? 3 : 2;
    made.epsilon = bits & 4u ? EK_R(1e-4) : EK_R(0.0);
    made.max_correspondence = bits & 8u ? LIMIT : EK_R(0.0);
    made.error_before = bits >> 4 & 1;
    made.one_to_one = bits >> 5 & 1;
    made.error = (ek_error_measure)(bits >> 6);
    return made;
}

int main(void)
{
    const unsigned numbers = (PLACES + 1u) * (PLACES + 1u) * (PLACES + 1u);
    const ek_pose guesses[] = {{EK_R(0.0), EK_R(0.0), EK_R(0.0)}, {LIMIT, EK_R(0.0), EK_PI}, {EK_R(0.0), EK_R(-1.0), EK_R(0.5)}};
    ek_arena arena = memory_of(1u << 16);
    ek_index index;
    ek_icp icp;
    cloud source, target;
    CHECK(ek_index_init(&index, &arena, MOST, 16u) == EK_OK && ek_icp_init(&icp, &arena, MOST, MOST) == EK_OK);
    CHECK(ek_arena_check(&arena) == EK_OK);
    for (unsigned t = 0; t < numbers; t++) {
        if (!cloud_of(t, &target)) {
            continue;
        }
        CHECK(ek_index_build(&index, target.xy, target.count) == EK_OK);
        for (unsigned s = 1; s < numbers && failures < 20; s++) {
            if (!cloud_of(s, &source)) {
                continue;
            }
            for (unsigned bits = 0; bits < 3u * 64u; bits++) {
                const ek_icp_parameters parameters = corner(bits);
                for (size_t g = 0; g < sizeof guesses / sizeof *guesses; g++) {
                    register_once(&icp, &index, &source, &target, guesses[g], &parameters);
                }
            }
        }
    }
    free(arena.memory);
    CHECK(registrations == 119ull * 120ull * 192ull * 3ull); /* multisets of 1 to 3, and of 0 to 3, of 7 places */
    return verdict();
}

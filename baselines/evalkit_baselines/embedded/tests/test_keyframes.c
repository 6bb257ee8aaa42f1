/* Distances through the graph of random drives, against the ways through every keyframe in turn (Floyd 1962). */
#include "line.h"

#define MOST 16u

static size_t random_index(uint64_t *seed, size_t below)
{
    return (size_t)uniform(seed, 0.0, (double)below - 1e-3);
}

static double shorter(double one, double other)
{
    return one < other ? one : other;
}

static void distances_are_those_of_all_ways(uint64_t *seed)
{
    static const double lengths[] = {0.0, 1e9, 1e12}; /* of steps by odometry alone, and of unknown ones */
    double way[MOST][MOST];
    ek_keyframes *const keyframes = &slam.keyframes;
    const size_t count = 2u + random_index(seed, MOST - 2u), loops = random_index(seed, LINE_LOOPS + 1u);
    keyframes->count = 0u;
    ek_pose_graph_reset(&keyframes->graph);
    for (size_t k = 0; k < count; k++) {
        const double step = k ? (double)uniform(seed, 0.1, 3.0) : 0.0;
        const size_t kind = random_index(seed, 4u) ? 0u : random_index(seed, 3u);
        add_keyframe(step, (ek_step_kind)kind);
        for (size_t i = 0; i < k; i++) {
            way[i][k] = way[k][i] = i + 1u < k ? 1e12 : kind ? lengths[kind] : step;
        }
        way[k][k] = 0.0;
    }
    for (int with_loops = 0; with_loops < 2; with_loops++) {
        for (size_t l = 0; with_loops && l < loops; l++) {
            const size_t second = 1u + random_index(seed, count - 1u), first = random_index(seed, second);
            const ek_loop_edge loop = edge_of((uint32_t)first, (uint32_t)second, ORIGIN, 1.0);
            CHECK(ek_pose_graph_close(&keyframes->graph, &loop) == EK_OK);
            way[first][second] = way[second][first] = shorter(way[first][second], 0.5);
        }
        for (size_t over = 0; over < count; over++) {
            for (size_t i = 0; i < count; i++) {
                for (size_t k = 0; k < count; k++) {
                    way[i][k] = shorter(way[i][k], way[i][over] + way[over][k]);
                }
            }
        }
        ek_work spent = ek_work_make(INT64_MAX);
        if (with_loops) { /* otherwise what was summed up with each keyframe */
            ek_keyframes_measure(keyframes, &spent);
            CHECK(spent.done >= 2u * (count - 1u) + loops && spent.done <= (loops + 1u) * (2u * (count - 1u) + loops));
        }
        for (size_t k = 0; k < count; k++) {
            const double expected = shorter(way[count - 1u][k], 1e12);
            CHECK_NEAR(keyframes->apart[k], expected, 1e-6 * (1.0 + expected));
        }
    }
}

/* Parts of the drive are counted; a keyframe keeps the place of its points, and costs an operation for each before it. */
static void keyframes_are_numbered(void)
{
    static const ek_step_kind kinds[] = {EK_STEP_UNKNOWN, EK_STEP_MATCHED, EK_STEP_MEASURED, EK_STEP_MATCHED, EK_STEP_UNKNOWN};
    static const uint32_t sections[] = {0u, 0u, 1u, 1u, 2u};
    ek_keyframes *const keyframes = &slam.keyframes;
    keyframes->count = 0u;
    ek_pose_graph_reset(&keyframes->graph);
    for (size_t k = 0; k < 5u; k++) {
        work = ek_work_make(INT64_MAX);
        add_keyframe(2.0, kinds[k]);
        CHECK(work.done == k + 1u && keyframes->section[k] == sections[k] && keyframes->kind[k] == (uint8_t)kinds[k]);
        CHECK(keyframes->start[k] == k && keyframes->start[k + 1u] == k + 1u);
        CHECK_NEAR(keyframes->path[k], 2.0 * (double)(k + 1u), TOLERANCE);
        CHECK_NEAR(keyframes->points[2u * k + 1u], 1.0, 0.0);
    }
}

/* Information over a step of d m: the variance grows with the path, from 5 cm on; a corridor of half the openness, (0.2 -
 * ratio) / (0.2 - 0.045), has ten times more along it. */
static void the_information_of_a_step_follows_its_length(void)
{
    static const double steps[] = {0.01, 0.05, 0.4, 2.0}, ratios[] = {0.3, 0.2, 0.1225, 0.045, 0.0}, shares[] = {0.0, 0.0, 0.5, 1.0, 1.0};
    const double sigma = 0.02, turn = 0.3 * (double)EK_PI / 180.0;
    for (size_t k = 0; k < 4u; k++) {
        for (size_t r = 0; r < 5u; r++) {
            const ek_openness open = {.x = EK_R(0.6), .y = EK_R(-0.8), .ratio = EK_R(ratios[r])};
            const ek_real point[] = {EK_R(0.0), EK_R(0.0)};
            ek_keyframes *const keyframes = &slam.keyframes;
            keyframes->count = 0u;
            ek_pose_graph_reset(&keyframes->graph);
            add_keyframe(0.0, EK_STEP_MATCHED);
            const ek_pose step = pose_of(0.6 * steps[k], -0.8 * steps[k], 1.0);
            CHECK(ek_keyframes_add(keyframes, point, 1u, AT_BASE, step, EK_STEP_MATCHED, &open, CERTAIN, &work) == EK_OK);
            const double length = steps[k] > 0.05 ? steps[k] : 0.05, variance = sigma * sigma * length;
            const double along = 20.0 * variance * shares[r];
            ek_sym3 covariance;
            CHECK(ek_sym3_inverse(&keyframes->graph.step[1].information, &covariance));
            CHECK_NEAR((double)covariance.xx / (variance + 0.36 * along), 1.0, 1e-4);
            CHECK_NEAR((double)covariance.yy / (variance + 0.64 * along), 1.0, 1e-4);
            CHECK_NEAR((double)covariance.xy / variance, -0.48 * along / variance, 1e-4);
            CHECK_NEAR((double)covariance.tt / (turn * turn * length), 1.0, 1e-4);
        }
    }
}

int main(void)
{
    uint64_t seed = 5u;
    ek_arena arena = line_of(0u);
    for (int k = 0; k < 300; k++) {
        distances_are_those_of_all_ways(&seed);
    }
    keyframes_are_numbered();
    the_information_of_a_step_follows_its_length();
    free(arena.memory);
    return verdict();
}

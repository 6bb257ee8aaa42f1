/* Every parameter's default and both sides of its bounds, every capacity and every pointer: as the headers say. */
#include "check.h"
#include "ek/normals.h"
#include "ek/pipeline.h"
#include "ek/scanlog.h"
#include "ek/slam.h"
#include "ek/table.h"

#define ROOM 64u
#define MILLION ((size_t)1 << 20)
#define BILLION ((size_t)1 << 30)

static const ek_real NO_NUMBERS[] = {(ek_real)NAN, (ek_real)INFINITY, -(ek_real)INFINITY};
static const ek_pose ORIGIN = {EK_R(0.0), EK_R(0.0), EK_R(0.0)};
static ek_arena none; /* only counts */

static ek_icp_parameters icp;
static ek_frontend_parameters frontend;
static ek_grid_parameters grid;
static ek_loop_settings loop;
static ek_scan_parameters scan;
static ek_slam_parameters slam;

/* The status of default parameters of a kind with one of them changed. */
#define STATUS(kind, member, value) (kind = kind##_default(), kind.member = (value), kind##_status())

/* The bounds themselves are allowed; a number a little beyond them is not, and what is no number has its own answer. */
#define REAL(kind, member, least, most, no_number)                                                                    \
    do {                                                                                                              \
        CHECK(STATUS(kind, member, EK_R(least)) == EK_OK);                                                            \
        CHECK(STATUS(kind, member, EK_R(most)) == EK_OK);                                                             \
        CHECK(STATUS(kind, member, EK_R((least) - 1e-3 * (1e-3 + fabs(least)))) == EK_OUT_OF_RANGE);                  \
        CHECK(STATUS(kind, member, EK_R((most) + 1e-3 * (1e-3 + fabs(most)))) == EK_OUT_OF_RANGE);                    \
        for (size_t k = 0; k < 3u; k++) {                                                                             \
            CHECK(STATUS(kind, member, NO_NUMBERS[k]) == (no_number));                                                \
        }                                                                                                             \
    } while (0)

/* The same for whole numbers. */
#define WHOLE(kind, member, least, most)                                                                              \
    do {                                                                                                              \
        CHECK(STATUS(kind, member, least) == EK_OK && STATUS(kind, member, most) == EK_OK);                           \
        CHECK(STATUS(kind, member, (least) - 1) == EK_OUT_OF_RANGE);                                                  \
        CHECK(STATUS(kind, member, (most) + 1) == EK_OUT_OF_RANGE);                                                   \
    } while (0)

/* The same for the values of an enumeration, from 0. */
#define VALUES(kind, member, type, most)                                                                              \
    do {                                                                                                              \
        CHECK(STATUS(kind, member, (type)0) == EK_OK && STATUS(kind, member, most) == EK_OK);                         \
        CHECK(STATUS(kind, member, (type)-1) == EK_OUT_OF_RANGE);                                                     \
        CHECK(STATUS(kind, member, (type)((most) + 1)) == EK_OUT_OF_RANGE);                                           \
    } while (0)

/* The same without an upper bound. */
#define REAL_FROM_ZERO(kind, member, no_number)                                                                       \
    do {                                                                                                              \
        CHECK(STATUS(kind, member, EK_R(0.0)) == EK_OK && STATUS(kind, member, EK_R(1e30)) == EK_OK);                 \
        CHECK(STATUS(kind, member, EK_R(-1e-6)) == EK_OUT_OF_RANGE);                                                  \
        for (size_t k = 0; k < 3u; k++) {                                                                             \
            CHECK(STATUS(kind, member, NO_NUMBERS[k]) == (no_number));                                                \
        }                                                                                                             \
    } while (0)

static ek_icp_parameters icp_default(void)
{
    return ek_icp_default();
}

static ek_status icp_status(void)
{
    return ek_icp_check(&icp);
}

static ek_frontend_parameters frontend_default(void)
{
    return ek_frontend_default();
}

static ek_status frontend_status(void)
{
    return ek_frontend_check(&frontend);
}

static ek_grid_parameters grid_default(void)
{
    return ek_grid_default();
}

static ek_status grid_status(void)
{
    return ek_grid_check(&grid);
}

static ek_loop_settings loop_default(void)
{
    return ek_loop_default();
}

static ek_status loop_status(void)
{
    return ek_loop_check(&loop);
}

static ek_scan_parameters scan_default(void)
{
    return ek_slam_default().scan;
}

static ek_status scan_status(void)
{
    return ek_scan_check(&scan);
}

static ek_slam_parameters slam_default(void)
{
    return ek_slam_default();
}

static ek_status slam_status(void)
{
    size_t bytes = 1u;
    const ek_status status = ek_slam_bytes(&slam, &bytes);
    CHECK((status == EK_OK) == (bytes > 0u));
    return status;
}

static void of_a_registration(void)
{
    VALUES(icp, error, ek_error_measure, EK_ERROR_RMSE);
    VALUES(icp, metric, ek_metric, EK_METRIC_LINE);
    CHECK(STATUS(icp, max_iterations, 1) == EK_OK && STATUS(icp, max_iterations, 0) == EK_OUT_OF_RANGE);
    CHECK(STATUS(icp, min_pairs, 2) == EK_OK && STATUS(icp, min_pairs, 1) == EK_OUT_OF_RANGE);
    REAL_FROM_ZERO(icp, epsilon, EK_OUT_OF_RANGE);
    REAL_FROM_ZERO(icp, max_correspondence, EK_OUT_OF_RANGE);
    REAL_FROM_ZERO(icp, cauchy, EK_OUT_OF_RANGE);
    CHECK(ek_icp_check(NULL) == EK_NULL_POINTER);
}

static void of_a_front_end(void)
{
    ek_frontend made;
    WHOLE(frontend, keyframes, 1u, 1024u);
    WHOLE(frontend, points, 1u, MILLION);
    REAL_FROM_ZERO(frontend, keyframe_distance, EK_NOT_FINITE);
    REAL_FROM_ZERO(frontend, keyframe_angle, EK_NOT_FINITE);
    CHECK(STATUS(frontend, min_inliers, 0) == EK_OK && STATUS(frontend, min_inliers, -1) == EK_OUT_OF_RANGE);
    CHECK(STATUS(frontend, neighbours, 1u) == EK_OK); /* of no meaning without lines */
    CHECK(STATUS(frontend, map_voxel, EK_R(-0.1)) == EK_OUT_OF_RANGE);
    CHECK(STATUS(frontend, map_voxel, (ek_real)NAN) == EK_OUT_OF_RANGE);
    for (int stage = 0; stage < 2; stage++) {
        frontend = ek_frontend_default();
        (stage ? &frontend.scan_to_map : &frontend.scan_to_scan)->metric = EK_METRIC_LINE;
        CHECK(ek_frontend_check(&frontend) == EK_OK);
        for (uint32_t k = 0; k < 2u; k++) {
            frontend.neighbours = k ? EK_MAX_NEIGHBOURS + 1u : 1u;
            CHECK(ek_frontend_check(&frontend) == EK_OUT_OF_RANGE);
        }
    }
    frontend = ek_frontend_default();
    CHECK(STATUS(frontend, scan_to_scan.epsilon, EK_R(-1.0)) == EK_OUT_OF_RANGE);
    CHECK(STATUS(frontend, scan_to_map.epsilon, EK_R(-1.0)) == EK_OUT_OF_RANGE);
    CHECK(ek_frontend_check(NULL) == EK_NULL_POINTER);
    CHECK(ek_frontend_init(&made, &none, &frontend) == EK_OUT_OF_RANGE);
    frontend = ek_frontend_default();
    CHECK(ek_frontend_init(NULL, &none, &frontend) == EK_NULL_POINTER);
    CHECK(ek_frontend_init(&made, NULL, &frontend) == EK_NULL_POINTER);
    frontend.cells = BILLION + 1u;
    CHECK(ek_frontend_init(&made, &none, &frontend) == EK_OUT_OF_RANGE);
    frontend.cells = 1000u;
    CHECK(ek_frontend_init(&made, &none, &frontend) == EK_OK && made.local_map.cell_capacity == 1000u);
}

static void of_a_map(void)
{
    ek_grid made;
    REAL(grid, l_occ, 0.0, 15.0, EK_NOT_FINITE);
    REAL(grid, l_free, -15.0, 0.0, EK_NOT_FINITE);
    REAL(grid, l_min, -15.0, 0.0, EK_NOT_FINITE);
    REAL(grid, l_max, 0.0, 15.0, EK_NOT_FINITE);
    REAL(grid, widest_gap, 0.0, 1.5, EK_NOT_FINITE);
    CHECK(STATUS(grid, resolution, EK_R(10.0)) == EK_OK && STATUS(grid, resolution, EK_R(10.01)) == EK_OUT_OF_RANGE);
    CHECK(STATUS(grid, resolution, EK_R(12.0 / 8000.0)) == EK_OK); /* at most 8192 cells to the end of a beam */
    CHECK(STATUS(grid, resolution, EK_R(12.0 / 8300.0)) == EK_OUT_OF_RANGE);
    CHECK(STATUS(grid, range_max, EK_R(0.0)) == EK_OUT_OF_RANGE && STATUS(grid, range_max, EK_R(1e-3)) == EK_OK);
    grid = ek_grid_default();
    grid.range_max = EK_R(1.0);
    grid.resolution = EK_R(0.001);
    CHECK(ek_grid_check(&grid) == EK_OK);
    grid.resolution = EK_R(0.000999);
    CHECK(ek_grid_check(&grid) == EK_OUT_OF_RANGE);
    grid.resolution = EK_R(1.0);
    grid.range_max = EK_R(1000.0);
    CHECK(ek_grid_check(&grid) == EK_OK);
    grid.range_max = EK_R(1001.0);
    CHECK(ek_grid_check(&grid) == EK_OUT_OF_RANGE);
    for (uint32_t cells = 0u; cells <= 32800u; cells += 16u) {
        const ek_status expected = cells % 32u == 0u && cells > 0u && cells <= 32768u ? EK_OK : EK_OUT_OF_RANGE;
        CHECK(STATUS(grid, columns, cells) == expected && STATUS(grid, rows, cells) == expected);
    }
    static const int32_t last[] = {-(1 << 30), 1 << 30}, beyond[] = {-(1 << 30) - 32, (1 << 30) + 32}, between[] = {-16, 16};
    for (size_t k = 0; k < 2u; k++) {
        CHECK(STATUS(grid, left, last[k]) == EK_OK && STATUS(grid, bottom, last[k]) == EK_OK);
        CHECK(STATUS(grid, left, beyond[k]) == EK_OUT_OF_RANGE && STATUS(grid, bottom, beyond[k]) == EK_OUT_OF_RANGE);
        CHECK(STATUS(grid, left, between[k]) == EK_OUT_OF_RANGE && STATUS(grid, bottom, between[k]) == EK_OUT_OF_RANGE);
    }
    grid = ek_grid_default();
    grid.rolling = 1;
    CHECK(ek_grid_check(&grid) == EK_OK);
    grid.columns = 512u; /* two times 13 m in cells of 5 cm need 576 */
    CHECK(ek_grid_check(&grid) == EK_OUT_OF_RANGE);
    grid.resolution = EK_R(1.0); /* 47 m and two cells to either side, a cell in the middle, and words begun: 161 */
    grid.range_max = EK_R(46.0);
    for (uint32_t cells = 96u; cells <= 192u; cells += 32u) {
        grid.columns = grid.rows = cells;
        CHECK(ek_grid_check(&grid) == (cells < 160u ? EK_OUT_OF_RANGE : EK_OK));
    }
    grid = ek_grid_default();
    grid.rolling = 1;
    grid.rows = 512u;
    CHECK(ek_grid_check(&grid) == EK_OUT_OF_RANGE && ek_grid_check(NULL) == EK_NULL_POINTER);
    CHECK(ek_grid_init(NULL, &none, &grid) == EK_NULL_POINTER && ek_grid_init(&made, NULL, &grid) == EK_NULL_POINTER);
    CHECK(ek_grid_add_scan(NULL, ORIGIN, EK_R(0.0), EK_R(0.0), NULL, 0u, NULL, 0u) == EK_NULL_POINTER);
}

static void of_a_scan(void)
{
    ek_scan made;
    ek_sweep sweep;
    ek_real number[1] = {EK_R(1.0)};
    CHECK(STATUS(scan, range_min, EK_R(0.0)) == EK_OK && STATUS(scan, range_min, EK_R(-1e-6)) == EK_OUT_OF_RANGE);
    CHECK(STATUS(scan, range_min, EK_R(12.0)) == EK_OUT_OF_RANGE); /* as large as range_max */
    CHECK(STATUS(scan, range_max, EK_R(1000.0)) == EK_OK && STATUS(scan, range_max, EK_R(1000.1)) == EK_OUT_OF_RANGE);
    REAL_FROM_ZERO(scan, local_radius, EK_NOT_FINITE);
    for (size_t k = 0; k < 3u; k++) {
        CHECK(STATUS(scan, range_min, NO_NUMBERS[k]) == EK_NOT_FINITE);
        CHECK(STATUS(scan, range_max, NO_NUMBERS[k]) == EK_NOT_FINITE);
        CHECK(STATUS(scan, base_from_sensor.x, NO_NUMBERS[k]) == EK_NOT_FINITE);
        CHECK(STATUS(scan, base_from_sensor.y, NO_NUMBERS[k]) == EK_NOT_FINITE);
        CHECK(STATUS(scan, base_from_sensor.theta, NO_NUMBERS[k]) == EK_NOT_FINITE);
    }
    CHECK(ek_scan_check(NULL) == EK_NULL_POINTER);
    CHECK(ek_scan_init(NULL, &none, 1u) == EK_NULL_POINTER && ek_scan_init(&made, NULL, 1u) == EK_NULL_POINTER);
    CHECK(ek_scan_init(&made, &none, 0u) == EK_OUT_OF_RANGE && ek_scan_init(&made, &none, BILLION + 1u) == EK_OUT_OF_RANGE);
    memset(&sweep, 0, sizeof sweep);
    scan = ek_slam_default().scan;
    sweep.ranges = sweep.angles = number;
    CHECK(ek_scan_project(NULL, &sweep, &scan, NULL) == EK_NULL_POINTER);
    CHECK(ek_scan_project(&made, NULL, &scan, NULL) == EK_NULL_POINTER);
    CHECK(ek_scan_project(&made, &sweep, NULL, NULL) == EK_NULL_POINTER);
    sweep.angles = NULL;
    CHECK(ek_scan_project(&made, &sweep, &scan, NULL) == EK_NULL_POINTER);
    sweep.ranges = NULL;
    CHECK(ek_scan_project(&made, &sweep, &scan, NULL) == EK_NULL_POINTER);
}

/* All settings lie between 0 and 1e6, some of them closer. */
static void of_a_loop_finder(void)
{
    static const size_t places[] = {offsetof(ek_loop_settings, path), offsetof(ek_loop_settings, spacing),
                                    offsetof(ek_loop_settings, submap), offsetof(ek_loop_settings, near),
                                    offsetof(ek_loop_settings, degenerate), offsetof(ek_loop_settings, gate),
                                    offsetof(ek_loop_settings, quick_gate)};
    static const struct {
        ek_real number;
        ek_status status;
    } tries[] = {{EK_R(1e6), EK_OK},           {EK_R(1.1e6), EK_OUT_OF_RANGE},  {EK_R(-1e-6), EK_OUT_OF_RANGE},
                 {(ek_real)NAN, EK_NOT_FINITE}, {(ek_real)INFINITY, EK_NOT_FINITE}};
    for (size_t k = 0; k < sizeof places / sizeof *places; k++) {
        for (size_t i = 0; i < sizeof tries / sizeof *tries; i++) {
            loop = ek_loop_default();
            memcpy((unsigned char *)&loop + places[k], &tries[i].number, sizeof(ek_real));
            CHECK(ek_loop_check(&loop) == tries[i].status);
        }
    }
    REAL(loop, score, 0.0, 1.0, EK_NOT_FINITE);
    REAL(loop, ambiguity, 0.0, 1.0, EK_NOT_FINITE);
    REAL(loop, overlap, 0.0, 1.0, EK_NOT_FINITE);
    REAL(loop, cell, 7.0 / 127.0 * (1.0 + 1e-6), 1.0, EK_NOT_FINITE); /* a radius of 7 m is at most 127 cells */
    loop = ek_loop_default();
    loop.radius = EK_R(1.0);
    loop.cell = EK_R(0.02);
    CHECK(ek_loop_check(&loop) == EK_OK);
    loop.radius = EK_R(15.875); /* 127 cells */
    loop.cell = EK_R(0.125);
    CHECK(ek_loop_check(&loop) == EK_OK);
    loop.radius = EK_R(1.0);
    loop.cell = EK_R(0.0199);
    CHECK(ek_loop_check(&loop) == EK_OUT_OF_RANGE);
    CHECK(STATUS(loop, near, EK_R(0.0)) == EK_OUT_OF_RANGE && ek_loop_check(NULL) == EK_NULL_POINTER);

    ek_loop_finder made;
    const ek_icp_parameters match = ek_icp_default();
    loop = ek_loop_default();
    CHECK(ek_loop_finder_init(&made, &none, &loop, &match, &match, 100u, MILLION) == EK_OK);
    CHECK(ek_loop_finder_init(NULL, &none, &loop, &match, &match, 100u, MILLION) == EK_NULL_POINTER);
    CHECK(ek_loop_finder_init(&made, NULL, &loop, &match, &match, 100u, MILLION) == EK_NULL_POINTER);
    CHECK(ek_loop_finder_init(&made, &none, &loop, NULL, &match, 100u, MILLION) == EK_NULL_POINTER);
    CHECK(ek_loop_finder_init(&made, &none, &loop, &match, NULL, 100u, MILLION) == EK_NULL_POINTER);
    CHECK(ek_loop_finder_init(&made, &none, NULL, &match, &match, 100u, MILLION) == EK_NULL_POINTER);
    CHECK(ek_loop_finder_init(&made, &none, &loop, &match, &match, 0u, MILLION) == EK_OUT_OF_RANGE);
    CHECK(ek_loop_finder_init(&made, &none, &loop, &match, &match, 100u, 128u * 128u - 1u) == EK_OUT_OF_RANGE);
}

static void of_the_slam(void)
{
    size_t bytes = 1u;
    ek_slam made;
    ek_slam_estimate estimate;
    unsigned char memory[EK_ALIGNMENT] = {0};
    REAL(slam, fine_correspondence, 0.0, 1e6, EK_NOT_FINITE);
    REAL(slam, keyframe_distance, 0.0, 1e6, EK_NOT_FINITE);
    REAL(slam, keyframe_angle, 0.0, 1e6, EK_NOT_FINITE);
    REAL(slam, map_radius, 0.0, 1e6, EK_NOT_FINITE);
    REAL(slam, map_reach, 0.0, 1e6, EK_NOT_FINITE);
    REAL(slam, map_voxel, 0.01, 100.0, EK_OUT_OF_RANGE);
    WHOLE(slam, points, 1u, MILLION);
    WHOLE(slam, records, 1u, MILLION);
    WHOLE(slam, keyframes, 1u, MILLION);
    WHOLE(slam, loops, 1u, 1024u);
    WHOLE(slam, score_cells, 128u * 128u, (size_t)1 << 26);
    CHECK(STATUS(slam, work, 0) == EK_OK && STATUS(slam, work, -1) == EK_OUT_OF_RANGE);
    CHECK(STATUS(slam, min_inliers, 0) == EK_OK && STATUS(slam, min_inliers, -1) == EK_OUT_OF_RANGE);
    CHECK(STATUS(slam, map_points, 0u) == EK_OUT_OF_RANGE && STATUS(slam, map_points, BILLION + 1u) == EK_OUT_OF_RANGE);
    CHECK(STATUS(slam, voxels, 0u) == EK_OUT_OF_RANGE && STATUS(slam, voxels, ((size_t)1 << 26) + 1u) == EK_OUT_OF_RANGE);
    CHECK(STATUS(slam, loop_points, 0u) == EK_OUT_OF_RANGE && STATUS(slam, loop_points, MILLION + 1u) == EK_OUT_OF_RANGE);
    CHECK(STATUS(slam, keyframe_points, 0u) == EK_OUT_OF_RANGE);
    CHECK(STATUS(slam, keyframe_points, BILLION + 1u) == EK_OUT_OF_RANGE);
    CHECK(STATUS(slam, drift.sigma, EK_R(0.0)) == EK_OUT_OF_RANGE);
    CHECK(STATUS(slam, drift.sigma_theta, EK_R(0.0)) == EK_OUT_OF_RANGE);
    CHECK(STATUS(slam, drift.sigma, (ek_real)INFINITY) == EK_OUT_OF_RANGE);
    CHECK(STATUS(slam, drift.sigma_theta, (ek_real)INFINITY) == EK_OUT_OF_RANGE);
    CHECK(STATUS(slam, scan.range_max, (ek_real)NAN) == EK_NOT_FINITE);
    CHECK(STATUS(slam, matcher.min_pairs, 1) == EK_OUT_OF_RANGE);
    slam = ek_slam_default();
    CHECK(ek_slam_bytes(&slam, NULL) == EK_NULL_POINTER && ek_slam_bytes(NULL, &bytes) == EK_NULL_POINTER);
    CHECK(ek_slam_start(NULL, memory, sizeof memory, &slam) == EK_NULL_POINTER);
    CHECK(ek_slam_start(&made, NULL, 0u, &slam) == EK_NULL_POINTER);
    CHECK(ek_slam_start(&made, memory, sizeof memory, NULL) == EK_NULL_POINTER);
    slam.work = -1;
    CHECK(ek_slam_start(&made, memory, sizeof memory, &slam) == EK_OUT_OF_RANGE);
    CHECK(ek_slam_update(NULL, NULL, &estimate) == EK_NULL_POINTER && ek_slam_update(&made, NULL, &estimate) == EK_NULL_POINTER);
}

static void of_the_pipeline(void)
{
    size_t bytes = 1u;
    ek_pipeline made;
    ek_estimate estimate;
    ek_sweep sweep;
    unsigned char memory[EK_ALIGNMENT] = {0};
    ek_pipeline_parameters parameters = ek_pipeline_default();
    memset(&sweep, 0, sizeof sweep);
    CHECK(ek_pipeline_bytes(NULL, &bytes) == EK_NULL_POINTER && ek_pipeline_bytes(&parameters, NULL) == EK_NULL_POINTER);
    CHECK(ek_pipeline_start(NULL, memory, sizeof memory, &parameters) == EK_NULL_POINTER);
    CHECK(ek_pipeline_start(&made, NULL, 0u, &parameters) == EK_NULL_POINTER);
    CHECK(ek_pipeline_start(&made, memory, sizeof memory, NULL) == EK_NULL_POINTER);
    CHECK(ek_pipeline_update(NULL, &sweep, &estimate) == EK_NULL_POINTER);
    CHECK(ek_pipeline_update(&made, NULL, &estimate) == EK_NULL_POINTER);
    CHECK(ek_pipeline_update(&made, &sweep, NULL) == EK_NULL_POINTER);
    parameters.grid.rows = 33u;
    CHECK(ek_pipeline_bytes(&parameters, &bytes) == EK_OUT_OF_RANGE && bytes == 0u);
    CHECK(ek_pipeline_start(&made, memory, sizeof memory, &parameters) == EK_OUT_OF_RANGE);
    parameters.map = 0; /* without a map its parameters do not matter */
    CHECK(ek_pipeline_bytes(&parameters, &bytes) == EK_OK && bytes > 0u);
    parameters.frontend.keyframes = 0u;
    CHECK(ek_pipeline_bytes(&parameters, &bytes) == EK_OUT_OF_RANGE);
    parameters.scan.range_max = (ek_real)NAN;
    CHECK(ek_pipeline_bytes(&parameters, &bytes) == EK_NOT_FINITE);
}

/* Counts of a module with one capacity: 0 and one above the largest are refused, as are missing pointers. */
#define CAPACITY(type, init, most)                                                                                    \
    do {                                                                                                              \
        type made;                                                                                                    \
        CHECK(init(&made, &none, 1u) == EK_OK && init(&made, &none, most) == EK_OK);                                  \
        CHECK(init(&made, &none, 0u) == EK_OUT_OF_RANGE && init(&made, &none, (most) + 1u) == EK_OUT_OF_RANGE);       \
        CHECK(init(NULL, &none, 1u) == EK_NULL_POINTER && init(&made, NULL, 1u) == EK_NULL_POINTER);                  \
    } while (0)

/* The same for two capacities. */
#define CAPACITIES(type, init, most, other)                                                                           \
    do {                                                                                                              \
        type made;                                                                                                    \
        CHECK(init(&made, &none, 1u, 1u) == EK_OK && init(&made, &none, most, other) == EK_OK);                       \
        CHECK(init(&made, &none, 0u, 1u) == EK_OUT_OF_RANGE && init(&made, &none, 1u, 0u) == EK_OUT_OF_RANGE);        \
        CHECK(init(&made, &none, (most) + 1u, 1u) == EK_OUT_OF_RANGE);                                                \
        CHECK(init(&made, &none, 1u, (other) + 1u) == EK_OUT_OF_RANGE);                                               \
        CHECK(init(NULL, &none, 1u, 1u) == EK_NULL_POINTER && init(&made, NULL, 1u, 1u) == EK_NULL_POINTER);          \
    } while (0)

static ek_status table_init(ek_table *made, ek_arena *arena, size_t tiles, size_t blocks)
{
    static ek_index index;
    CHECK(ek_index_init(&index, &none, ROOM, ROOM) == EK_OK);
    CHECK(ek_table_init(made, &none, NULL, 1u, 1u) == EK_NULL_POINTER);
    return ek_table_init(made, arena, &index, tiles, blocks);
}

static ek_status keyframes_init(ek_keyframes *made, ek_arena *arena, size_t capacity, size_t points)
{
    const ek_drift drift = {EK_R(0.02), EK_R(0.005)};
    return ek_keyframes_init(made, arena, capacity, points, 8u, drift);
}

static ek_status score_grid_init(ek_score_grid *made, ek_arena *arena, size_t over)
{
    return ek_score_grid_init(made, arena, over + 128u * 128u - 1u);
}

static void of_capacities(void)
{
    CAPACITY(ek_scan, ek_scan_init, BILLION);
    CAPACITY(ek_thinner, ek_thinner_init, BILLION);
    CAPACITY(ek_index_updater, ek_index_updater_init, BILLION);
    CAPACITY(ek_search, ek_search_init, MILLION);
    CAPACITY(ek_observer, ek_observer_init, BILLION);
    CAPACITY(ek_continuity, ek_continuity_init, BILLION);
    CAPACITY(ek_score_grid, score_grid_init, ((size_t)1 << 26) - 128u * 128u + 1u);
    CAPACITIES(ek_index, ek_index_init, BILLION, BILLION);
    CAPACITIES(ek_icp, ek_icp_init, BILLION, BILLION);
    CAPACITIES(ek_pose_graph, ek_pose_graph_init, MILLION, (size_t)1024);
    CAPACITIES(ek_table, table_init, (size_t)1 << 26, (size_t)1 << 26);
    CAPACITIES(ek_keyframes, keyframes_init, MILLION, BILLION);
    ek_icp made;
    CHECK(ek_icp_init_lines(NULL, &none) == EK_NULL_POINTER && ek_icp_init_lines(&made, NULL) == EK_NULL_POINTER);
    CHECK(ek_icp_init_table(NULL, &none) == EK_NULL_POINTER && ek_icp_init_table(&made, NULL) == EK_NULL_POINTER);
    ek_voxel_map map;
    ek_lasting_map lasting;
    CHECK(ek_lasting_map_init(NULL, &none, 1u, EK_R(0.1), EK_R(1.0), 1u, 0u) == EK_NULL_POINTER);
    CHECK(ek_lasting_map_init(&lasting, NULL, 1u, EK_R(0.1), EK_R(1.0), 1u, 0u) == EK_NULL_POINTER);
    CHECK(ek_voxel_map_init(NULL, &none, 1u, EK_R(0.1), 1u) == EK_NULL_POINTER);
    CHECK(ek_voxel_map_init(&map, NULL, 1u, EK_R(0.1), 1u) == EK_NULL_POINTER);
    CHECK(ek_voxel_map_keep_views(NULL, &none) == EK_NULL_POINTER && ek_voxel_map_keep_views(&map, NULL) == EK_NULL_POINTER);
    CHECK(ek_voxel_map_init(&map, &none, 1u, EK_R(0.1), 0u) == EK_OUT_OF_RANGE);
    CHECK(ek_voxel_map_init(&map, &none, (size_t)1 << 26, EK_R(0.01), 1u) == EK_OK);
    CHECK(ek_voxel_map_init(&map, &none, ((size_t)1 << 26) + 1u, EK_R(0.01), 1u) == EK_OUT_OF_RANGE);
    CHECK(ek_lasting_map_init(&lasting, &none, 1u, EK_R(0.1), EK_R(1e6), 1u, 0u) == EK_OK);
    CHECK(ek_lasting_map_init(&lasting, &none, 1u, EK_R(0.1), EK_R(1.1e6), 1u, 0u) == EK_OUT_OF_RANGE);
    CHECK(ek_lasting_map_init(&lasting, &none, 1u, EK_R(0.1), EK_R(0.0), 1u, 0u) == EK_OUT_OF_RANGE);
}

static void of_calls(void)
{
    static ek_index index;
    static ek_index_updater updater;
    static ek_icp matcher;
    static ek_search search;
    static ek_score_grid cells;
    static ek_table table;
    static ek_pose_graph graph;
    static ek_frontend odometry;
    ek_arena arena = memory_of(2000000u);
    ek_real xy[4] = {EK_R(0.0), EK_R(1.0), EK_R(2.0), EK_R(3.0)}, normals[4];
    ek_match match;
    icp = ek_icp_default();
    CHECK(ek_index_init(&index, &arena, 2u, ROOM) == EK_OK && ek_index_updater_init(&updater, &arena, 2u) == EK_OK);
    CHECK(ek_icp_init(&matcher, &arena, 2u, 2u) == EK_OK && ek_search_init(&search, &arena, 2u) == EK_OK);
    CHECK(ek_score_grid_init(&cells, &arena, 128u * 128u) == EK_OK && ek_pose_graph_init(&graph, &arena, 2u, 1u) == EK_OK);
    CHECK(ek_arena_check(&arena) == EK_OK);

    CHECK(ek_index_build(NULL, xy, 2u) == EK_NULL_POINTER && ek_index_build(&index, NULL, 2u) == EK_NULL_POINTER);
    CHECK(ek_index_build(&index, xy, 2u) == EK_OK);
    CHECK(ek_index_update(NULL, &index, 0u, xy, 0u) == EK_NULL_POINTER);
    CHECK(ek_index_update(&updater, NULL, 0u, xy, 0u) == EK_NULL_POINTER);
    CHECK(ek_index_update(&updater, &index, 1u, NULL, 1u) == EK_NULL_POINTER);
    CHECK(ek_index_update(&updater, &index, 0u, NULL, 0u) == EK_OK && index.count == 2u);
    CHECK(ek_normals_compute(NULL, 2u, EK_FAR, normals) == EK_NULL_POINTER);
    CHECK(ek_normals_defer(NULL, 2u, normals) == EK_NULL_POINTER && ek_normals_defer(&index, 2u, NULL) == EK_NULL_POINTER);
    CHECK(ek_normals_defer(&index, EK_MAX_NEIGHBOURS + 1u, normals) == EK_OUT_OF_RANGE);

    CHECK(ek_icp_register(NULL, &index, xy, 2u, ORIGIN, &icp, NULL, NULL, &match) == EK_NULL_POINTER);
    CHECK(ek_icp_register(&matcher, NULL, xy, 2u, ORIGIN, &icp, NULL, NULL, &match) == EK_NULL_POINTER);
    CHECK(ek_icp_register(&matcher, &index, xy, 2u, ORIGIN, NULL, NULL, NULL, &match) == EK_NULL_POINTER);
    CHECK(ek_icp_register(&matcher, &index, xy, 2u, ORIGIN, &icp, NULL, NULL, NULL) == EK_NULL_POINTER);
    for (int axis = 0; axis < 2; axis++) {
        const ek_pose far = {axis ? EK_R(0.0) : EK_R(1.1e6), axis ? EK_R(-1.1e6) : EK_R(0.0), EK_R(0.0)};
        CHECK(ek_icp_register(&matcher, &index, xy, 2u, far, &icp, NULL, NULL, &match) == EK_OUT_OF_RANGE);
        xy[2 + axis] = EK_R(1.1e6);
        CHECK(ek_icp_register(&matcher, &index, xy, 2u, ORIGIN, &icp, NULL, NULL, &match) == EK_OUT_OF_RANGE);
        CHECK(ek_index_update(&updater, &index, 2u, xy, 2u) == EK_OUT_OF_RANGE);
        xy[2 + axis] = (ek_real)NAN;
        CHECK(ek_icp_register(&matcher, &index, xy, 2u, ORIGIN, &icp, NULL, NULL, &match) == EK_NOT_FINITE);
        CHECK(ek_index_update(&updater, &index, 2u, xy, 2u) == EK_NOT_FINITE && index.count == 2u);
        xy[2 + axis] = EK_R(2.0);
    }
    for (int k = 0; k < 4; k++) { /* the edge of the world belongs to it */
        const ek_real edge = k % 2 ? EK_R(1e6) : EK_R(-1e6);
        const ek_pose at = {k < 2 ? edge : EK_R(0.0), k < 2 ? EK_R(0.0) : edge, EK_R(0.0)};
        xy[0] = at.x;
        xy[1] = at.y;
        CHECK(ek_icp_register(&matcher, &index, xy, 2u, at, &icp, NULL, NULL, &match) == EK_OK);
        CHECK(ek_index_build(&index, xy, 2u) == EK_OK && ek_index_update(&updater, &index, 2u, xy, 2u) == EK_OK);
        ek_pose_graph_reset(&graph);
        const ek_sym3 any = {EK_R(1.0), EK_R(0.0), EK_R(0.0), EK_R(1.0), EK_R(0.0), EK_R(1.0)};
        CHECK(ek_pose_graph_add(&graph, ORIGIN, &any) == EK_OK && ek_pose_graph_add(&graph, at, &any) == EK_OK);
        ek_pose_graph_reset(&graph);
    }
    xy[0] = EK_R(0.0);
    xy[1] = EK_R(1.0);
    CHECK(ek_index_build(&index, xy, 2u) == EK_OK);
    matcher.targets = 1u; /* an index of two points */
    CHECK(ek_icp_register(&matcher, &index, xy, 2u, ORIGIN, &icp, NULL, NULL, &match) == EK_OUT_OF_RANGE);
    matcher.targets = 2u;
    index.table = &table;
    matcher.choice = NULL;
    CHECK(ek_icp_register(&matcher, &index, xy, 2u, ORIGIN, &icp, NULL, NULL, &match) == EK_NULL_POINTER); /* memory */
    index.table = NULL;
    matcher.grouped = 0;
    icp.metric = EK_METRIC_LINE;
    CHECK(ek_icp_register(&matcher, &index, xy, 2u, ORIGIN, &icp, NULL, NULL, &match) == EK_NULL_POINTER); /* memory */
    CHECK(ek_icp_init_lines(&matcher, &arena) == EK_OK && ek_arena_check(&arena) == EK_OK);
    index.normals = NULL;
    CHECK(ek_icp_register(&matcher, &index, xy, 2u, ORIGIN, &icp, NULL, NULL, &match) == EK_NULL_POINTER); /* normals */
    CHECK(ek_index_build(&index, NULL, 0u) == EK_OK); /* no point, no normals */
    CHECK(ek_icp_register(&matcher, &index, xy, 2u, ORIGIN, &icp, NULL, NULL, &match) == EK_OK && match.inliers == 0);
    CHECK(ek_normals_defer(&index, 2u, NULL) == EK_OK && ek_normals_compute(&index, 2u, EK_FAR, NULL) == EK_OK);

    const ek_search_window window = {ORIGIN, EK_R(1.0), EK_R(1.0), EK_R(0.1)};
    const ek_search_prior prior = {EK_R(1.0), EK_R(1.0), EK_R(1.0)};
    cells.cell = EK_R(0.1);
    CHECK(ek_search_begin(NULL, &cells, xy, 2u, &window, &prior, EK_R(0.5)) == EK_NULL_POINTER);
    CHECK(ek_search_begin(&search, NULL, xy, 2u, &window, &prior, EK_R(0.5)) == EK_NULL_POINTER);
    CHECK(ek_search_begin(&search, &cells, NULL, 2u, &window, &prior, EK_R(0.5)) == EK_NULL_POINTER);
    CHECK(ek_search_begin(&search, &cells, xy, 2u, NULL, &prior, EK_R(0.5)) == EK_NULL_POINTER);
    CHECK(ek_search_begin(&search, &cells, xy, 2u, &window, NULL, EK_R(0.5)) == EK_NULL_POINTER);
    CHECK(ek_search_begin(&search, &cells, xy, 0u, &window, &prior, EK_R(0.5)) == EK_NO_POINTS);
    CHECK(ek_search_begin(&search, &cells, xy, 3u, &window, &prior, EK_R(0.5)) == EK_TOO_MANY_POINTS);
    CHECK(ek_search_begin(&search, &cells, xy, 2u, &window, &prior, EK_R(0.5)) == EK_OK);

    ek_sym3 unit = {EK_R(1.0), EK_R(0.0), EK_R(0.0), EK_R(1.0), EK_R(0.0), EK_R(1.0)};
    ek_solver_settings settings = {1, EK_R(0.0), EK_R(0.0)};
    ek_loop_edge edge = {0u, 1u, ORIGIN, unit, EK_R(1.0)};
    CHECK(ek_pose_graph_begin(&graph, &settings, 1) == EK_OUT_OF_RANGE); /* no pose */
    CHECK(ek_pose_graph_add(NULL, ORIGIN, &unit) == EK_NULL_POINTER && ek_pose_graph_add(&graph, ORIGIN, NULL) == EK_NULL_POINTER);
    CHECK(ek_pose_graph_add(&graph, ORIGIN, &unit) == EK_OK);
    for (size_t k = 0; k < 3u; k++) {
        ek_pose far = ORIGIN;
        (k ? &far.y : &far.x)[0] = k < 2u ? EK_R(-1.1e6) : (ek_real)NAN;
        CHECK(ek_pose_graph_add(&graph, far, &unit) == (k < 2u ? EK_OUT_OF_RANGE : EK_NOT_FINITE));
    }
    unit.xt = (ek_real)NAN;
    CHECK(ek_pose_graph_add(&graph, ORIGIN, &unit) == EK_NOT_FINITE && graph.count == 1u);
    unit.xt = EK_R(0.0);
    CHECK(ek_pose_graph_add(&graph, ORIGIN, &unit) == EK_OK && ek_pose_graph_add(&graph, ORIGIN, &unit) == EK_TOO_MANY_POINTS);
    CHECK(ek_pose_graph_close(NULL, &edge) == EK_NULL_POINTER && ek_pose_graph_close(&graph, NULL) == EK_NULL_POINTER);
    CHECK(ek_pose_graph_close(&graph, &edge) == EK_OK && ek_pose_graph_close(&graph, &edge) == EK_TOO_MANY_POINTS);
    CHECK(ek_pose_graph_begin(NULL, &settings, 1) == EK_NULL_POINTER && ek_pose_graph_begin(&graph, NULL, 1) == EK_NULL_POINTER);
    CHECK(ek_pose_graph_predict(NULL, 0u, 1u) == EK_NULL_POINTER && ek_pose_graph_predict(&graph, 0u, 2u) == EK_OUT_OF_RANGE);
    for (size_t k = 0; k < 2u; k++) {
        ek_real *const changed = k ? &settings.phi : &settings.tolerance;
        *changed = EK_R(-1e-6);
        CHECK(ek_pose_graph_begin(&graph, &settings, 1) == EK_OUT_OF_RANGE);
        *changed = (ek_real)NAN;
        CHECK(ek_pose_graph_begin(&graph, &settings, 1) == EK_OUT_OF_RANGE);
        *changed = EK_R(0.0);
    }
    CHECK(ek_pose_graph_begin(&graph, &settings, 1) == EK_OK);

    frontend = ek_frontend_default();
    frontend.points = 2u;
    ek_arena measured = ek_arena_make(NULL, 0u);
    CHECK(ek_frontend_init(&odometry, &measured, &frontend) == EK_OK);
    ek_arena memory = memory_of(measured.used);
    CHECK(ek_frontend_init(&odometry, &memory, &frontend) == EK_OK && ek_arena_check(&memory) == EK_OK);
    ek_frontend_reset(&odometry);
    ek_prior given = {1, 1, {(ek_real)NAN, EK_R(0.0), EK_R(0.0)}};
    ek_estimate estimate;
    CHECK(ek_frontend_update(NULL, xy, 2u, &given, &estimate) == EK_NULL_POINTER);
    CHECK(ek_frontend_update(&odometry, xy, 2u, NULL, &estimate) == EK_NULL_POINTER);
    CHECK(ek_frontend_update(&odometry, xy, 2u, &given, NULL) == EK_NULL_POINTER);
    CHECK(ek_frontend_update(&odometry, NULL, 2u, &given, &estimate) == EK_NULL_POINTER);
    CHECK(ek_frontend_update(&odometry, xy, 2u, &given, &estimate) == EK_NOT_FINITE);
    xy[1] = EK_R(1.1e6);
    given.has_odometry = 0;
    CHECK(ek_frontend_update(&odometry, xy, 2u, &given, &estimate) == EK_OUT_OF_RANGE);
    CHECK(ek_frontend_update(&odometry, NULL, 0u, &given, &estimate) == EK_OK && !estimate.keyframe);
    free(memory.memory);
    free(arena.memory);
}

/* Every default in its unit; angles in degrees. */
static void of_defaults(void)
{
    const ek_icp_parameters match = ek_icp_default();
    const ek_frontend_parameters front = ek_frontend_default(), lines = ek_frontend_lines();
    const ek_pipeline_parameters pipeline = ek_pipeline_default();
    const ek_slam_parameters whole = ek_slam_default();
    const ek_grid_parameters map = ek_grid_default();
    const ek_loop_settings closing = ek_loop_default();
    const double degree = 3.14159265358979323846 / 180.0;
    const struct {
        ek_real found;
        double expected;
    } numbers[] = {
        {match.epsilon, 1e-4},           {match.max_correspondence, 0.3},  {match.cauchy, 0.0},
        {front.keyframe_distance, 0.5},  {front.keyframe_angle, 20.0 * degree}, {front.map_voxel, 0.0},
        {front.map_radius, 15.0},        {map.resolution, 0.05},           {map.l_occ, 0.847},
        {map.l_free, -0.847},            {map.l_min, -5.0},                {map.l_max, 5.0},
        {map.range_max, 12.0},           {map.widest_gap, 3.0 * degree},   {pipeline.scan.range_min, 0.15},
        {pipeline.scan.range_max, 12.0}, {pipeline.scan.local_radius, 0.0}, {pipeline.scan.base_from_sensor.x, 0.0},
        {whole.scan.range_min, 0.15},    {whole.scan.range_max, 12.0},     {whole.matcher.epsilon, 1e-6},
        {whole.matcher.cauchy, 0.1},     {whole.matcher.max_correspondence, 1.0}, {whole.fine_correspondence, 0.3},
        {whole.keyframe_distance, 0.3},  {whole.keyframe_angle, 10.0 * degree}, {whole.map_voxel, 0.1},
        {whole.map_radius, 30.0},        {whole.map_reach, 20.0},          {whole.drift.sigma, 0.02},
        {whole.drift.sigma_theta, 0.3 * degree}, {closing.path, 15.0},     {closing.spacing, 1.0},
        {closing.radius, 7.0},           {closing.submap, 3.0},            {closing.cell, 0.1},
        {closing.score, 0.55},           {closing.ambiguity, 0.92},        {closing.near, 0.15},
        {closing.overlap, 0.7},          {closing.degenerate, 0.13},       {closing.gate, 11.345},
        {closing.in_view, 0.95},         {closing.quick_gate, 6.25},
        {lines.keyframe_distance, 0.3},   {lines.keyframe_angle, 10.0 * degree},
        {lines.map_voxel, 0.1},          {lines.scan_to_scan.epsilon, 1e-6}, {lines.scan_to_map.epsilon, 1e-6},
        {lines.scan_to_scan.cauchy, 0.1}, {lines.scan_to_map.cauchy, 0.1}, {lines.scan_to_scan.max_correspondence, 1.0},
        {lines.scan_to_map.max_correspondence, 1.0}};
    for (size_t k = 0; k < sizeof numbers / sizeof *numbers; k++) {
        CHECK_NEAR(numbers[k].found, numbers[k].expected, 1e-7 * fabs(numbers[k].expected));
    }
    CHECK(match.max_iterations == 40 && match.min_pairs == 3 && match.one_to_one == 1 && match.error_before == 0);
    CHECK(match.error == EK_ERROR_MEAN && match.metric == EK_METRIC_POINT && match.share_noise == 0);
    CHECK(front.use_scan_to_scan == 1 && front.use_scan_to_map == 1 && front.min_inliers == 10);
    CHECK(front.keyframes == 10u && front.points == 2048u && front.cells == 0u && front.neighbours == 8u);
    CHECK(lines.scan_to_scan.metric == EK_METRIC_LINE && lines.scan_to_map.metric == EK_METRIC_LINE);
    CHECK(lines.scan_to_scan.one_to_one == 0 && lines.scan_to_map.one_to_one == 0 && lines.neighbours == 8u);
    CHECK(front.voxels == 16384u && pipeline.deskew == 1 && pipeline.map == 1);
    CHECK(map.columns == 1024u && map.rows == 1024u && map.left == -512 && map.bottom == -512);
    CHECK(map.rolling == 0 && map.polygon == 0);
    CHECK(whole.matcher.one_to_one == 0 && whole.matcher.metric == EK_METRIC_LINE && whole.min_inliers == 10);
    CHECK(whole.matcher.share_noise == 1);
    CHECK(whole.deskew == 1 && whole.use_odometry == 1 && whole.work == 200000 && whole.points == 2048u);
    CHECK(whole.keyframes == 2000u && whole.keyframe_points == 1000000u && whole.loops == 64u && whole.records == 512u);
    CHECK(whole.voxels == 16384u && whole.map_points == 12288u && whole.loop_points == 16384u);
    CHECK(whole.score_cells == (size_t)512 * 512);
}

/* Memory that is too small, missing or not aligned is named, and nothing is written to it. */
static void of_memory(void)
{
    static ek_index index;
    static ek_scan projected;
    static ek_voxel_map map;
    static ek_grid cells;
    unsigned char *const bytes = memory_of(4096u).memory;
    ek_arena empty = ek_arena_make(NULL, 4096u), shifted = ek_arena_make(bytes + 1, 4095u);
    ek_arena little[4];
    for (size_t k = 0; k < 4u; k++) {
        little[k] = ek_arena_make(bytes, EK_ALIGNMENT);
    }
    CHECK(ek_arena_check(&empty) == EK_TOO_LITTLE_MEMORY && ek_arena_check(&shifted) == EK_TOO_LITTLE_MEMORY);
    grid = ek_grid_default();
    CHECK(ek_index_init(&index, &little[0], ROOM, ROOM) == EK_OK && ek_scan_init(&projected, &little[1], ROOM) == EK_OK);
    CHECK(ek_voxel_map_init(&map, &little[2], ROOM, EK_R(0.1), 1u) == EK_OK && ek_grid_init(&cells, &little[3], &grid) == EK_OK);
    for (size_t k = 0; k < 4u; k++) {
        CHECK(ek_arena_check(&little[k]) == EK_TOO_LITTLE_MEMORY);
    }
    for (size_t k = 0; k < 4096u; k++) {
        CHECK(bytes[k] == 0xA5u);
    }
    little[0] = ek_arena_make(bytes, EK_ARENA_LINE);
    CHECK(ek_arena_alloc(&little[0], 5u, 0u) == bytes && little[0].used == (EK_ARENA_GAP ? EK_ARENA_LINE : 0u));
    free(bytes);
}

int main(void)
{
    none = ek_arena_make(NULL, 0u);
    of_a_registration();
    of_a_front_end();
    of_a_map();
    of_a_scan();
    of_a_loop_finder();
    of_the_slam();
    of_the_pipeline();
    of_capacities();
    of_calls();
    of_defaults();
    of_memory();
    return verdict();
}

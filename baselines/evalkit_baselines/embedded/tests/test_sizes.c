/* How much memory each part takes: the sum of its arrays by hand, each rounded up to the alignment of blocks. */
#include "check.h"
#include "ek/lasting_map.h"
#include "ek/pipeline.h"
#include "ek/slam.h"
#include "ek/table.h"
#include "ek/wide.h"

#define REAL sizeof(ek_real)
#define WORD 4u

static size_t total; /* bytes by hand */

static void block(size_t count, size_t size)
{
    total += (count * size + EK_ARENA_GAP + EK_ARENA_LINE - 1u) / EK_ARENA_LINE * EK_ARENA_LINE;
}

static void blocks(size_t times, size_t count, size_t size)
{
    for (size_t k = 0; k < times; k++) {
        block(count, size);
    }
}

/* Blocks of a registration: with vectors one of a page or more ends 320 bytes after the beginning of a page, counted from its own
 * beginning. */
static void spread(size_t times, size_t count, size_t size)
{
    size_t bytes = count * size;
    while (EK_GROUPED && count * size >= 4096u && bytes % 4096u != 320u) {
        bytes += size;
    }
    blocks(times, bytes / size, size);
}

/* Cells of an index: 16 a point, up to a bound. */
static size_t cells_of(size_t points, size_t most)
{
    return 16u * points < most ? 16u * points : most;
}

static void index_of(size_t points, size_t cells)
{
    block(2u * (points + 1u), REAL);
    block(points + 1u, WORD);
    block(cells + 2u + 32u, WORD);
    block(points + 1u, WORD);
}

static void candidates_of(size_t points)
{
    const size_t padded = (points + 7u) / 8u * 8u;
    blocks(2u, 6u * padded, REAL);
    block(6u * padded, WORD);
    spread(1u, padded, REAL);
}

static void icp_of(size_t points, size_t targets, int lines)
{
    const size_t padded = (points + 7u) / 8u * 8u;
    spread(12u, padded, REAL);
    spread(4u, padded, WORD);
    block(targets + 1u, WORD);
    if (EK_GROUPED) {
        candidates_of(points);
    }
    spread(lines ? 5u : 0u, padded, REAL);
    spread(lines ? 1u : 0u, padded, WORD);
}

static void thinner_of(size_t points)
{
    blocks(2u, points, 8u);
    blocks(2u, points, WORD);
    block(2049u, WORD);
}

static void observer_of(size_t points)
{
    index_of(points, cells_of(points, (size_t)1 << 16));
    blocks(2u, points, 2u * REAL);
}

static void scan_of(size_t beams)
{
    blocks(2u, 2u * beams, REAL);
    blocks(3u, beams, REAL);
}

static void updater_of(size_t points)
{
    block(2u * (points + 1u), REAL);
    block(points + 1u, WORD);
    block(2u * points, WORD);
    block(513u, WORD);
}

static void continuity_of(size_t points)
{
    index_of(points, cells_of(points, (size_t)1 << 16));
    blocks(2u, points, sizeof(ek_sight_ray));
    block(2u * points, REAL);
    block(points, WORD);
}

static void voxels_of(size_t voxels, size_t entries)
{
    block(voxels, sizeof(ek_voxel));
    block(entries, WORD);
}

static void views_of(size_t voxels)
{
    block(voxels, 2u * REAL);
}

static void graph_of(size_t poses, size_t loops)
{
    block(poses, sizeof(ek_pose));
    block(poses, sizeof(ek_step));
    block(loops, sizeof(ek_loop_edge));
    block(poses, sizeof(ek_pose));
    block(poses, sizeof(ek_sym3));
    block(3u * poses, REAL);
    block(loops, REAL);
    block(loops, WORD);
    block(9u * ((loops + 1u) * (loops + 2u) / 2u), REAL);
    block(3u * (loops + 1u), REAL);
}

static void keyframes_of(size_t poses, size_t points, size_t loops)
{
    graph_of(poses, loops);
    block(points, 2u * REAL);
    block(poses, 2u * REAL);
    block(poses + 1u, sizeof(size_t));
    blocks(2u, poses, REAL);
    block(poses, WORD);
    block(poses, 1u);
}

static void finder_of(size_t points, size_t cells)
{
    thinner_of(points);
    index_of(points, 4u * points);
    icp_of(points, points, 1);
    blocks(6u, cells, 1u);
    blocks(2u, points, WORD);
    observer_of(points);
    blocks(5u, points, 2u * REAL);
}

/* A map of 16384 voxels has 32768 entries. */
static void lasting_map_of(size_t around, size_t points, int lines)
{
    voxels_of(16384u, 32768u);
    index_of(around, cells_of(around, (size_t)1 << 18));
    blocks(lines ? 2u : 1u, around, 2u * REAL);
    blocks(lines ? 1u : 0u, around, WORD);
    block(points, 2u * REAL);
    block(points, 2u * WORD);
}

static void frontend_of(size_t points, size_t keyframes, int lines)
{
    const size_t all = points * keyframes;
    blocks(lines ? 1u : 0u, all, 2u * REAL);
    index_of(all, cells_of(all, (size_t)1 << 18));
    updater_of(all);
    block(2u * points, REAL);
    block(keyframes, sizeof(size_t));
    index_of(points, cells_of(points, (size_t)1 << 18));
    icp_of(points, all, lines);
    blocks(lines ? 1u : 0u, points, 2u * REAL);
}

/* A window of `side` x `side` bits, and the cells of a map of 1024 x 1024. */
static void grid_of(size_t side, int polygon)
{
    block((size_t)1024 * 1024, 2u);
    blocks(2u, side * side / 32u + 1u, WORD);
    blocks(polygon ? 2u : 1u, side * side / 32u, WORD);
}

#define TAKES(init, by_hand)                                                                                          \
    do {                                                                                                              \
        ek_arena arena = ek_arena_make(NULL, 0u);                                                                     \
        total = 0u;                                                                                                   \
        by_hand;                                                                                                      \
        CHECK((init) == EK_OK && arena.used == total);                                                                \
    } while (0)

static void small_parts(void)
{
    static const size_t counts[] = {1u, 5u, 100u, 5000u, 20000u};
    for (size_t k = 0; k < sizeof counts / sizeof *counts; k++) {
        const size_t n = counts[k];
        ek_index index;
        ek_index_updater updater;
        ek_icp icp;
        ek_scan scan;
        ek_thinner thinner;
        ek_observer observer;
        ek_continuity continuity;
        ek_search search;
        ek_score_grid score_grid;
        ek_table table;
        TAKES(ek_index_init(&index, &arena, n, n + 7u), index_of(n, n + 7u));
        TAKES(ek_index_updater_init(&updater, &arena, n), updater_of(n));
        TAKES(ek_icp_init(&icp, &arena, n, n + 3u), icp_of(n, n + 3u, 0));
        TAKES(ek_icp_init_lines(&icp, &arena), (spread(5u, EK_PADDED(n), REAL), spread(1u, EK_PADDED(n), WORD)));
        TAKES(ek_icp_init_table(&icp, &arena), EK_GROUPED ? (void)0 : candidates_of(n));
        TAKES(ek_scan_init(&scan, &arena, n), scan_of(n));
        TAKES(ek_thinner_init(&thinner, &arena, n), thinner_of(n));
        TAKES(ek_observer_init(&observer, &arena, n), observer_of(n));
        TAKES(ek_continuity_init(&continuity, &arena, n), continuity_of(n));
        TAKES(ek_search_init(&search, &arena, n), blocks(2u, n, WORD));
        TAKES(ek_score_grid_init(&score_grid, &arena, 16384u + n), blocks(6u, 16384u + n, 1u));
        index.cell_capacity = n + 7u;
        TAKES(ek_table_init(&table, &arena, &index, n, 2u * n), (block(n + 7u, WORD), block(16u * (n + 1u), WORD),
                                                                 block(2u * n + 1u, sizeof(ek_block))));
    }
}

static void maps(void)
{
    static const size_t voxels[] = {1u, 8u, 9u, 1000u}, entries[] = {16u, 16u, 32u, 2048u};
    for (size_t k = 0; k < 4u; k++) {
        ek_voxel_map map;
        TAKES(ek_voxel_map_init(&map, &arena, voxels[k], EK_R(0.1), 1u), voxels_of(voxels[k], entries[k]));
        TAKES(ek_voxel_map_keep_views(&map, &arena), views_of(voxels[k]));
    }
    ek_lasting_map lasting;
    const ek_real voxel = EK_R(0.5);
    for (uint32_t lines = 0; lines < 2u; lines++) { /* 2 m in voxels of 0.5 m: a square of 12 x 12; 100 m: all of them */
        TAKES(ek_lasting_map_init(&lasting, &arena, 16384u, voxel, EK_R(2.0), 30u, 8u * lines),
              lasting_map_of(144u, 30u, (int)lines));
        TAKES(ek_lasting_map_init(&lasting, &arena, 16384u, voxel, EK_R(100.0), 30u, 8u * lines),
              lasting_map_of(16384u, 30u, (int)lines));
    }
    ek_grid_parameters p = ek_grid_default(); /* (12 + 1) / 0.05 + 2 = 262 cells to either side: 525, and words begun: 576 */
    ek_grid grid;
    for (p.polygon = 0; p.polygon < 2; p.polygon++) {
        TAKES(ek_grid_init(&grid, &arena, &p), grid_of(576u, p.polygon));
    }
}

static void wholes(void)
{
    const ek_drift drift = {EK_R(0.02), EK_R(0.005)};
    ek_keyframes keyframes;
    ek_pose_graph graph;
    TAKES(ek_pose_graph_init(&graph, &arena, 30u, 7u), graph_of(30u, 7u));
    TAKES(ek_keyframes_init(&keyframes, &arena, 30u, 500u, 7u, drift), keyframes_of(30u, 500u, 7u));
    ek_loop_finder finder;
    const ek_loop_settings settings = ek_loop_default();
    const ek_icp_parameters match = ek_icp_default();
    TAKES(ek_loop_finder_init(&finder, &arena, &settings, &match, &match, 100u, 20000u), finder_of(100u, 20000u));
    ek_frontend frontend;
    ek_frontend_parameters front = ek_frontend_default();
    front.points = 300u;
    front.keyframes = 4u;
    for (int lines = 0; lines < 2; lines++) {
        front.scan_to_map.metric = lines ? EK_METRIC_LINE : EK_METRIC_POINT;
        front.cells = 0u;
        TAKES(ek_frontend_init(&frontend, &arena, &front), frontend_of(300u, 4u, lines));
    }
    front.map_voxel = EK_R(0.5);
    front.map_radius = EK_R(2.0);
    TAKES(ek_frontend_init(&frontend, &arena, &front),
          (lasting_map_of(144u, 300u, 1), index_of(300u, 4800u), icp_of(300u, 300u, 1), block(300u, 2u * REAL)));

    ek_pipeline_parameters pipeline = ek_pipeline_default();
    size_t bytes = 0u;
    for (pipeline.map = 0; pipeline.map < 2; pipeline.map++) {
        total = 0u;
        scan_of(2048u);
        frontend_of(2048u, 10u, 0);
        if (pipeline.map) {
            grid_of(576u, 0);
        }
        CHECK(ek_pipeline_bytes(&pipeline, &bytes) == EK_OK && bytes == total);
    }
    const ek_slam_parameters p = ek_slam_default();
    total = 0u;
    icp_of(2048u, 12288u, 1);
    scan_of(2048u);
    index_of(2048u, 16u * 2048u);
    index_of(12288u, 16u * 12288u);
    thinner_of(12288u);
    observer_of(2048u);
    continuity_of(2048u);
    voxels_of(16384u, 32768u);
    voxels_of(16384u, 32768u);
    views_of(16384u);
    views_of(16384u);
    blocks(4u, 2048u, 2u * REAL); /* last_points, last_normals, moved, stored */
    block(2048u, 2u * WORD);
    blocks(4u, 12288u, 2u * REAL);
    blocks(6u, (size_t)512 * 512, 1u);
    blocks(2u, 2048u, WORD); /* cells of the search */
    block(12288u, WORD);
    block(2048u, REAL);
    keyframes_of(2000u, 1000000u, 64u);
    finder_of(16384u, (size_t)512 * 512);
    block(2000u, sizeof(ek_pose));
    block(512u, sizeof(ek_loop_record));
    block(64u, WORD);
    CHECK(ek_slam_bytes(&p, &bytes) == EK_OK && bytes == total);
}

/* Up to half of what addresses reach, exactly; what is refused once is refused for good. */
static void the_largest_arena(void)
{
    static const struct {
        size_t count, size;
        int fits;
    } cases[] = {{EK_ARENA_MAX / 16u, 16u, 1},      {EK_ARENA_MAX / 16u + 1u, 16u, 0}, {EK_ARENA_MAX - EK_ALIGNMENT, 1u, 1},
                 {EK_ARENA_MAX + 1u, 1u, 0},        {SIZE_MAX, SIZE_MAX, 0},           {0u, SIZE_MAX, 1},
                 {SIZE_MAX, 0u, 1}};
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        ek_arena arena = ek_arena_make(NULL, 0u);
        CHECK(ek_arena_alloc(&arena, cases[k].count, cases[k].size) == NULL);
        CHECK((arena.used == SIZE_MAX) == !cases[k].fits);
    }
    ek_arena arena = ek_arena_make(NULL, 0u);
    ek_arena_alloc(&arena, 2u, EK_ARENA_MAX / 2u); /* EK_ARENA_MAX is odd: one byte less */
    CHECK(arena.used != SIZE_MAX && arena.used > EK_ARENA_MAX);
    ek_arena_alloc(&arena, 1u, 1u);
    CHECK(arena.used == SIZE_MAX);

    unsigned char *const bytes = (unsigned char *)malloc(192u);
    CHECK(bytes != NULL);
    ek_arena own = ek_arena_make(bytes, 192u);
    CHECK(ek_arena_alloc(&own, 192u - EK_ARENA_GAP, 1u) == bytes && own.used == 192u && ek_arena_check(&own) == EK_OK);
    CHECK(ek_arena_alloc(&own, 1u, 1u) == NULL && ek_arena_check(&own) == EK_TOO_LITTLE_MEMORY);
    own = ek_arena_make(bytes, 191u);
    CHECK(ek_arena_alloc(&own, 177u, 1u) == NULL && ek_arena_check(&own) == EK_TOO_LITTLE_MEMORY);
    own = ek_arena_make(bytes + 1, 100u); /* not aligned */
    CHECK(ek_arena_check(&own) == EK_TOO_LITTLE_MEMORY);
    free(bytes);
}

int main(void)
{
    small_parts();
    maps();
    wholes();
    the_largest_arena();
    return verdict();
}

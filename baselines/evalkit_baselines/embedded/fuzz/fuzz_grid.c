/* Arbitrary scans: log-odds stay within their limits; a refused scan changes no cell. */
#include "ek/grid.h"
#include "input.h"

static ek_grid_parameters parameters_of(ek_input *input)
{
    ek_grid_parameters parameters = ek_grid_default();
    const uint8_t flags = take_byte(input);
    parameters.columns = 32u * (1u + flags % 4u);
    parameters.rows = 32u * (1u + flags / 8u % 4u);
    parameters.rolling = flags >> 6 & 1;
    parameters.polygon = flags >> 5 & 1;
    parameters.left = parameters.bottom = -32;
    parameters.range_max = flags >> 2 & 1 ? EK_R(1.0) : EK_R(0.2);
    if (flags >> 7) {
        parameters.resolution = take_real(input);
        parameters.range_max = take_real(input);
        parameters.l_occ = take_real(input);
        parameters.l_free = take_real(input);
        parameters.l_min = take_real(input);
        parameters.l_max = take_real(input);
        parameters.left = (int32_t)(uint32_t)take_whole(input);
        parameters.widest_gap = take_real(input);
    }
    return parameters;
}

static void add(ek_grid *grid, ek_input *input, int16_t *before)
{
    const size_t cells = (size_t)grid->parameters.columns * grid->parameters.rows;
    const size_t count = take_byte(input) % 32u, miss_count = take_byte(input) % 8u;
    const ek_pose pose = take_pose(input);
    const ek_real x = take_real(input), y = take_real(input);
    ek_real *const hits = take_reals(input, 2u * count), *const misses = take_reals(input, 2u * miss_count);
    memcpy(before, grid->cells, cells * sizeof *before);
    const ek_status status = ek_grid_add_scan(grid, pose, x, y, hits, count, misses, miss_count);
    if (status != EK_OK) {
        HOLDS(memcmp(before, grid->cells, cells * sizeof *before) == 0);
    } else {
        const ek_real least = EK_R(1000.0) * grid->parameters.l_min, most = EK_R(1000.0) * grid->parameters.l_max;
        HOLDS(grid->ignored_beams <= count + miss_count && grid->touched_cells <= cells);
        for (size_t i = 0; grid->parameters.polygon && i < (size_t)grid->window.lines * grid->window.words; i++) {
            HOLDS(grid->window.outline[i] == 0u);
        }
        for (size_t i = 0; i < cells; i++) {
            const ek_real cell = (ek_real)grid->cells[i];
            HOLDS(grid->cells[i] == EK_UNKNOWN || (cell >= least - EK_R(0.51) && cell <= most + EK_R(0.51)));
        }
    }
    free(hits);
    free(misses);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    ek_input input = {bytes, size};
    ek_grid grid;
    ek_arena measured = ek_arena_make(NULL, 0u);
    const ek_grid_parameters parameters = parameters_of(&input);
    if (ek_grid_init(&grid, &measured, &parameters) != EK_OK || measured.used > (size_t)1 << 21) {
        return 0;
    }
    ek_arena arena = memory_for(&measured);
    HOLDS(ek_grid_init(&grid, &arena, &parameters) == EK_OK && ek_arena_check(&arena) == EK_OK);
    int16_t *const before = (int16_t *)malloc((size_t)parameters.columns * parameters.rows * sizeof *before);
    HOLDS(before != NULL);
    for (int scans = 0; scans < 4 && input.left; scans++) {
        add(&grid, &input, before);
    }
    free(before);
    free(arena.memory);
    return 0;
}

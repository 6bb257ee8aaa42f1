#include "ek/grid.h"
#include "ek/polygon.h"
#include "ek/tally.h"
#include "ek/wide.h"

#include <string.h>

#define WORD EK_WORD
#define SPARE EK_R(1.0) /* m that deskewing may add to a range */
#define THOUSANDTHS EK_R(1000.0)
#define MAX_CELLS ((uint32_t)1 << 15) /* per side */

ek_grid_parameters ek_grid_default(void)
{
    ek_grid_parameters parameters;
    parameters.resolution = EK_R(0.05);
    parameters.l_occ = EK_R(0.847);
    parameters.l_free = EK_R(-0.847);
    parameters.l_min = EK_R(-5.0);
    parameters.l_max = EK_R(5.0);
    parameters.range_max = EK_R(12.0);
    parameters.columns = parameters.rows = 1024u;
    parameters.left = parameters.bottom = -512;
    parameters.rolling = parameters.polygon = 0;
    parameters.widest_gap = EK_R(3.0) * EK_PI / EK_R(180.0);
    return parameters;
}

/* Side of the window in cells, so that it covers a scan from any cell when aligned to words; parameters are checked. */
static uint32_t window_side(const ek_grid_parameters *parameters)
{
    const ek_real reach = (parameters->range_max + SPARE) / parameters->resolution + EK_R(2.0);
    return (2u * (uint32_t)reach + 1u + 2u * (WORD - 1u)) / WORD * WORD;
}

ek_status ek_grid_check(const ek_grid_parameters *parameters)
{
    if (!parameters) {
        return EK_NULL_POINTER;
    }
    const ek_grid_parameters p = *parameters;
    const ek_real numbers[] = {p.resolution, p.l_occ, p.l_free, p.l_min, p.l_max, p.range_max, p.widest_gap};
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) {
        if (!isfinite(numbers[i])) {
            return EK_NOT_FINITE;
        }
    }
    const int odds = p.l_occ >= EK_R(0.0) && p.l_free <= EK_R(0.0) && p.l_min <= EK_R(0.0) && p.l_max >= EK_R(0.0) &&
                     p.l_occ <= EK_R(15.0) && p.l_free >= EK_R(-15.0) && p.l_min >= EK_R(-15.0) &&
                     p.l_max <= EK_R(15.0);
    const int size = p.resolution >= EK_R(0.001) && p.resolution <= EK_R(10.0) && p.range_max > EK_R(0.0) &&
                     p.range_max / p.resolution <= EK_R(8192.0) && p.range_max <= EK_R(1000.0);
    const int whole = p.columns % WORD == 0u && p.rows % WORD == 0u && p.left % (int32_t)WORD == 0 &&
                      p.bottom % (int32_t)WORD == 0 && p.columns > 0u && p.rows > 0u && p.columns <= MAX_CELLS &&
                      p.rows <= MAX_CELLS;
    const int outline = p.widest_gap >= EK_R(0.0) && p.widest_gap <= EK_R(1.5);
    if (!odds || !size || !whole || !outline || p.left < -(1 << 30) || p.left > 1 << 30 || p.bottom < -(1 << 30) ||
        p.bottom > 1 << 30) {
        return EK_OUT_OF_RANGE;
    }
    return p.rolling && (window_side(&p) > p.columns || window_side(&p) > p.rows) ? EK_OUT_OF_RANGE : EK_OK;
}

ek_status ek_grid_init(ek_grid *grid, ek_arena *arena, const ek_grid_parameters *parameters)
{
    if (!grid || !arena) {
        return EK_NULL_POINTER;
    }
    const ek_status status = ek_grid_check(parameters);
    if (status != EK_OK) {
        return status;
    }
    memset(grid, 0, sizeof *grid);
    grid->parameters = *parameters;
    grid->window.lines = window_side(parameters);
    grid->window.words = grid->window.lines / WORD;
    const size_t bits = (size_t)grid->window.lines * grid->window.words;
    grid->cells = (int16_t *)ek_arena_alloc(arena, (size_t)parameters->columns * parameters->rows, sizeof(int16_t));
    grid->window.across = (uint32_t *)ek_arena_alloc(arena, bits + 1u, sizeof(uint32_t));
    grid->window.along = (uint32_t *)ek_arena_alloc(arena, bits + 1u, sizeof(uint32_t));
    grid->window.ends = (uint32_t *)ek_arena_alloc(arena, bits, sizeof(uint32_t));
    grid->window.outline =
        parameters->polygon ? (uint32_t *)ek_arena_alloc(arena, bits, sizeof(uint32_t)) : grid->window.across;
    if (arena->memory && ek_arena_check(arena) == EK_OK) {
        ek_window_init(&grid->window);
        ek_grid_clear(grid);
    }
    return EK_OK;
}

static void set_unknown(int16_t *cells, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        cells[i] = EK_UNKNOWN;
    }
}

void ek_grid_clear(ek_grid *grid)
{
    grid->left = grid->parameters.left;
    grid->bottom = grid->parameters.bottom;
    set_unknown(grid->cells, (size_t)grid->parameters.columns * grid->parameters.rows);
}

/* Move the map's corner; cells keep their position in the world, new cells are unknown. */
static void roll_map(ek_grid *grid, int32_t left, int32_t bottom)
{
    const int64_t columns = grid->parameters.columns, rows = grid->parameters.rows;
    const int64_t by_column = (int64_t)left - grid->left, by_row = (int64_t)bottom - grid->bottom;
    const int64_t skipped = by_column < 0 ? -by_column : by_column;
    for (int64_t k = 0; k < rows; k++) {
        const int64_t to = by_row < 0 ? rows - 1 - k : k, from = to + by_row;
        int16_t *const line = grid->cells + to * columns;
        if (from < 0 || from >= rows || skipped >= columns) {
            set_unknown(line, (size_t)columns);
            continue;
        }
        const int16_t *const old = grid->cells + from * columns;
        const size_t kept = (size_t)(columns - skipped);
        memmove(by_column < 0 ? line + skipped : line, by_column < 0 ? old : old + skipped, kept * sizeof *line);
        set_unknown(by_column < 0 ? line : line + kept, (size_t)skipped);
    }
    grid->left = left;
    grid->bottom = bottom;
}

static int32_t align_down(int32_t cell)
{
    const int32_t rest = cell % (int32_t)WORD;
    return cell - (rest < 0 ? rest + (int32_t)WORD : rest);
}

/* Centre the window on the sensor's cell; centre a rolling map on the window if the window would leave it. */
static void centre_window(ek_grid *grid, int32_t column, int32_t row)
{
    const int32_t lines = (int32_t)grid->window.lines, reach = (lines - (int32_t)WORD) / 2;
    const int32_t columns = (int32_t)grid->parameters.columns, rows = (int32_t)grid->parameters.rows;
    grid->window_left = align_down(column - reach);
    grid->window_bottom = align_down(row - reach);
    if (!grid->parameters.rolling) {
        return;
    }
    const int inside = grid->window_left >= grid->left && grid->window_left + lines <= grid->left + columns &&
                       grid->window_bottom >= grid->bottom && grid->window_bottom + lines <= grid->bottom + rows;
    if (!inside) {
        roll_map(grid, align_down(grid->window_left - (columns - lines) / 2),
                 align_down(grid->window_bottom - (rows - lines) / 2));
    }
}

/* Add half a word of marks to 16 cells. Without a branch, so that compilers vectorise it. */
EK_LOOP void add_half(int16_t *EK_RESTRICT cells, uint32_t freed, uint32_t hit, const int16_t odds[4])
{
    static const uint16_t bit[16] = {1,      2,      4,      8,      0x10,   0x20,   0x40,   0x80,
                                     0x100u, 0x200u, 0x400u, 0x800u, 0x1000u, 0x2000u, 0x4000u, 0x8000u};
    const uint16_t f = (uint16_t)freed, h = (uint16_t)hit;
    const int16_t l_free = odds[0], l_occ = odds[1], l_min = odds[2], l_max = odds[3];
    for (int k = 0; k < 16; k++) {
        const int16_t is_free = (int16_t)((f & bit[k]) == bit[k] ? -1 : 0);
        const int16_t is_hit = (int16_t)((h & bit[k]) == bit[k] ? -1 : 0);
        const int16_t old = cells[k], known = (int16_t)(old == EK_UNKNOWN ? 0 : old);
        int16_t sum = (int16_t)(known + (int16_t)(is_free & l_free) + (int16_t)(is_hit & l_occ));
        sum = sum < l_min ? l_min : sum;
        sum = sum > l_max ? l_max : sum;
        cells[k] = (is_free | is_hit) ? sum : old;
    }
}

/* Add l_free to 32 cells. */
EK_LOOP void free_word(int16_t *EK_RESTRICT cells, int16_t l_free, int16_t l_min)
{
    for (int k = 0; k < 32; k++) {
        const int16_t old = cells[k], sum = (int16_t)((old == EK_UNKNOWN ? 0 : old) + l_free);
        cells[k] = sum < l_min ? l_min : sum;
    }
}

EK_LOOP uint32_t count_bits(uint32_t word)
{
    word -= (word >> 1) & 0x55555555u;
    word = (word & 0x33333333u) + ((word >> 2) & 0x33333333u);
    return (((word + (word >> 4)) & 0x0F0F0F0Fu) * 0x01010101u) >> 24;
}

/* Add 32 words of marks, one of each row, to the map; the words lie `stride` apart. Returns the number of cells touched. */
EK_LOOP uint32_t add_words(int16_t *cells, size_t columns, const uint32_t *crossed, size_t stride, const uint32_t *ends,
                           size_t words, const int16_t odds[4])
{
    uint32_t touched = 0u;
    for (uint32_t k = 0; k < WORD; k++, cells += columns, crossed += stride, ends += words) {
        const uint32_t hit = *ends, freed = *crossed & ~hit;
        EK_COUNT(EK_FILLED, (freed | hit) != 0u);
        if (freed == UINT32_MAX) {
            free_word(cells, odds[0], odds[2]);
            touched += WORD;
        } else if (freed | hit) {
            add_half(cells, freed & 0xFFFFu, hit & 0xFFFFu, odds);
            add_half(cells + 16, freed >> 16, hit >> 16, odds);
            touched += count_bits(freed | hit);
        }
    }
    return touched;
}

EK_WIDE static uint32_t add_words_wide(int16_t *cells, size_t columns, const uint32_t *crossed, size_t stride,
                                       const uint32_t *ends, size_t words, const int16_t odds[4])
{
    return add_words(cells, columns, crossed, stride, ends, words, odds);
}

/* Add the marks of 32 x 32 cells of the window to the map. */
static void add_block(ek_grid *grid, uint32_t row, uint32_t word, int16_t *cells, const int16_t odds[4])
{
    const ek_window *const window = &grid->window;
    const size_t columns = grid->parameters.columns, words = window->words, at = (size_t)row * words + word;
    const int steep = word * WORD <= window->steep_right && window->steep_left <= word * WORD + (WORD - 1u);
    uint32_t block[WORD];
    if (steep) {
        ek_window_read_block(window, row, word, block);
    }
    const uint32_t *const crossed = steep ? block : window->across + at, *const ends = window->ends + at;
    grid->touched_cells += EK_IF_WIDE(window->wide)
                               ? add_words_wide(cells, columns, crossed, steep ? 1u : words, ends, words, odds)
                               : add_words(cells, columns, crossed, steep ? 1u : words, ends, words, odds);
}

static int16_t to_thousandths(ek_real odds)
{
    return (int16_t)EK_FLOOR(odds * THOUSANDTHS + EK_R(0.5));
}

/* Add the marks of the window to the map, where the window overlaps it. */
static void apply_window(ek_grid *grid)
{
    const ek_grid_parameters *const p = &grid->parameters;
    const int16_t odds[4] = {to_thousandths(p->l_free), to_thousandths(p->l_occ), to_thousandths(p->l_min),
                             to_thousandths(p->l_max)};
    const ek_marks marks = grid->window.marks;
    for (uint32_t row = marks.bottom / WORD * WORD; row <= marks.top; row += WORD) {
        const int64_t to_row = (int64_t)grid->window_bottom + row - grid->bottom;
        if (to_row < 0 || to_row >= (int64_t)p->rows) {
            continue;
        }
        for (uint32_t word = marks.left / WORD; word <= marks.right / WORD; word++) {
            EK_COUNT(EK_WORDS, WORD);
            const int64_t to_column = (int64_t)grid->window_left + word * WORD - grid->left;
            if (to_column >= 0 && to_column < (int64_t)p->columns) {
                add_block(grid, row, word, grid->cells + (size_t)to_row * p->columns + (size_t)to_column, odds);
            }
        }
    }
}

static ek_status check(const ek_grid *grid, ek_pose pose, ek_real x, ek_real y, const ek_real *hits, size_t count,
                       const ek_real *misses, size_t miss_count)
{
    if (!grid || (!hits && count) || (!misses && miss_count)) {
        return EK_NULL_POINTER;
    }
    if (!ek_se2_is_finite(pose) || !isfinite(x) || !isfinite(y)) {
        return EK_NOT_FINITE;
    }
    for (size_t i = 0; i < 2u * count; i++) {
        if (!isfinite(hits[i])) {
            return EK_NOT_FINITE;
        }
    }
    for (size_t i = 0; i < 2u * miss_count; i++) {
        if (!isfinite(misses[i])) {
            return EK_NOT_FINITE;
        }
    }
    const ek_real far_x = EK_FABS(pose.x) + EK_FABS(x) + EK_FABS(y), far_y = EK_FABS(pose.y) + EK_FABS(x) + EK_FABS(y);
    const ek_real farthest = EK_MAX_COORDINATE < EK_R(1e9) * grid->parameters.resolution
                                 ? EK_MAX_COORDINATE
                                 : EK_R(1e9) * grid->parameters.resolution; /* so that cell numbers fit 32 bits */
    return far_x <= farthest && far_y <= farthest ? EK_OK : EK_OUT_OF_RANGE;
}

ek_status ek_grid_add_scan(ek_grid *grid, ek_pose world_from_points, ek_real start_x, ek_real start_y,
                           const ek_real *hits, size_t count, const ek_real *misses, size_t miss_count)
{
    const ek_status status = check(grid, world_from_points, start_x, start_y, hits, count, misses, miss_count);
    if (status != EK_OK) {
        return status;
    }
    const ek_real per_metre = EK_R(1.0) / grid->parameters.resolution;
    const ek_real c = EK_COS(world_from_points.theta), s = EK_SIN(world_from_points.theta);
    const ek_real x = (world_from_points.x + c * start_x - s * start_y) / grid->parameters.resolution;
    const ek_real y = (world_from_points.y + s * start_x + c * start_y) / grid->parameters.resolution;
    centre_window(grid, (int32_t)EK_FLOOR(x), (int32_t)EK_FLOOR(y));
    ek_view view;
    view.c = c * per_metre;
    view.s = s * per_metre;
    view.start_x = x - (ek_real)grid->window_left;
    view.start_y = y - (ek_real)grid->window_bottom;
    view.x = world_from_points.x / grid->parameters.resolution - (ek_real)grid->window_left;
    view.y = world_from_points.y / grid->parameters.resolution - (ek_real)grid->window_bottom;
    ek_window_clear(&grid->window);
    grid->touched_cells = 0u;
    grid->ignored_beams =
        grid->parameters.polygon
            ? ek_window_fill_outline(&grid->window, &view, hits, count, grid->parameters.widest_gap)
            : ek_window_mark_beams(&grid->window, &view, hits, count, 1);
    grid->ignored_beams += ek_window_mark_beams(&grid->window, &view, misses, miss_count, 0);
    apply_window(grid);
    return EK_OK;
}

#include "ek/window.h"
#include "ek/tally.h"
#include "ek/wide.h"

#include <string.h>

#define WORD EK_WORD
#define SHORT 8 /* lines; those of shorter beams are marked one by one */
#define STRIP 64 /* lines of a beam that are marked together */

static void forget_marks(ek_window *window)
{
    const ek_marks none = {UINT32_MAX, 0u, UINT32_MAX, 0u};
    window->marks = none;
    window->steep_left = UINT32_MAX;
    window->steep_right = 0u;
}

void ek_window_init(ek_window *window)
{
    const size_t bytes = (size_t)window->lines * window->words * sizeof(uint32_t);
    memset(window->across, 0, bytes);
    memset(window->along, 0, bytes);
    memset(window->ends, 0, bytes);
    memset(window->outline, 0, bytes);
    forget_marks(window);
    window->wide = ek_wide();
}

/* Clear the lines `first` to `last`. */
static void clear_lines(const ek_window *window, uint32_t *bits, uint32_t first, uint32_t last)
{
    if (first <= last) {
        memset(bits + (size_t)first * window->words, 0, (size_t)(last - first + 1u) * window->words * sizeof *bits);
    }
}

void ek_window_clear(ek_window *window)
{
    clear_lines(window, window->across, window->marks.bottom, window->marks.top);
    clear_lines(window, window->ends, window->marks.bottom, window->marks.top);
    clear_lines(window, window->along, window->steep_left, window->steep_right);
    forget_marks(window);
}

/* Set the bits [from, to] of a line. */
static inline void mark(uint32_t *line, uint32_t from, uint32_t to)
{
    uint32_t word = from / WORD;
    uint32_t mask = UINT32_MAX << (from % WORD);
    EK_COUNT(EK_STEPS, 1u + to / WORD - word);
    for (; word < to / WORD; word++) {
        line[word] |= mask;
        mask = UINT32_MAX;
    }
    line[word] |= mask & (UINT32_MAX >> (WORD - 1u - to % WORD));
}

/* A beam along one axis of the window, in cells. */
typedef struct {
    ek_real from, to;
    int32_t first, last; /* cells of both ends */
} ek_extent;

/* A beam in cells: line k of the slow axis is left at ((k - behind) slope + start), a number of cells from the start. */
typedef struct {
    int32_t lines, cells;   /* of the slow and the fast axis between both ends */
    ek_real behind, slope, start;
    int32_t first, sign;    /* cell of the start on the fast axis, and the direction of the beam along it: 1 or -1 */
    ptrdiff_t line, stride; /* words to the line of the start, and to the next one */
} ek_course;

/* The course of a beam that crosses no more lines of the slow axis than of the fast axis. */
static inline ek_course plot_course(uint32_t words, ek_extent slow, ek_extent fast)
{
    const int up = slow.last > slow.first;
    ek_course course;
    course.lines = up ? slow.last - slow.first : slow.first - slow.last;
    course.cells = fast.last > fast.first ? fast.last - fast.first : fast.first - fast.last;
    course.slope = course.lines ? EK_FABS(fast.to - fast.from) / EK_FABS(slow.to - slow.from) : EK_R(0.0);
    /* 0 to 1, from the cell edge behind the start; either direction is valid for an axis that the beam does not cross
     */
    course.behind = up ? slow.from - (ek_real)slow.first : (ek_real)(slow.first + 1) - slow.from;
    course.start = fast.to >= fast.from ? fast.from - (ek_real)fast.first : (ek_real)(fast.first + 1) - fast.from;
    course.first = fast.first;
    course.sign = fast.last >= fast.first ? 1 : -1;
    course.stride = up ? (ptrdiff_t)words : -(ptrdiff_t)words;
    course.line = (ptrdiff_t)slow.first * (ptrdiff_t)words;
    return course;
}

/* Mark all cells of a beam that crosses no more lines of the slow axis than of the fast axis; `bits` holds one line
 * along the fast axis for each cell of the slow axis. A beam exactly through a corner goes diagonally. */
static void mark_beam(uint32_t *bits, const ek_course beam)
{
    ptrdiff_t line = beam.line;
    int32_t entry = 0;
    for (int32_t k = 1; k <= beam.lines + 1; k++, line += beam.stride) {
        const ek_real at = ((ek_real)k - beam.behind) * beam.slope + beam.start;
        const int32_t next =
            at < (ek_real)beam.cells ? (int32_t)at : beam.cells; /* rounding must not extend a beam past its end */
        int32_t leave = next - ((ek_real)next == at ? 1 : 0);
        leave = k > beam.lines ? beam.cells : leave < entry ? entry : leave;
        const int32_t from = beam.first + beam.sign * entry, to = beam.first + beam.sign * leave;
        mark(bits + line, (uint32_t)(beam.sign > 0 ? from : to), (uint32_t)(beam.sign > 0 ? to : from));
        entry = next;
    }
}

/* As mark_beam, with the same numbers: first the cells and masks of a strip of lines, in loops that compilers vectorise,
 * then the words, two at once: hardly ever does a line of a beam reach more. */
EK_WIDE static void mark_beam_wide(uint32_t *bits, const ek_course *beam)
{
    const ek_real behind = beam->behind, slope = beam->slope, start = beam->start, end = (ek_real)beam->cells;
    const int32_t cells = beam->cells, first = beam->first, sign = beam->sign;
    int32_t next[STRIP + 1], leave[STRIP];
    uint32_t word[STRIP], last[STRIP], low[STRIP], high[STRIP];
    ptrdiff_t at_line = beam->line;
    next[0] = 0;
    for (int32_t begin = 1; begin <= beam->lines + 1; begin += STRIP) {
        const int32_t rest = beam->lines + 2 - begin, count = rest < STRIP ? rest : STRIP;
        const int32_t full = (count + 7) / 8 * 8; /* some lines beyond the end, which are not marked */
        for (int32_t i = 0; i < full; i++) {
            const ek_real at = ((ek_real)(begin + i) - behind) * slope + start, within = at < end ? at : end;
            const int32_t cell = (int32_t)within, exact = (ek_real)cell == at;
            next[i + 1] = cell;
            leave[i] = cell - exact;
        }
        leave[count - 1] = rest <= STRIP ? cells : leave[count - 1];
        for (int32_t i = 0; i < full; i++) {
            const int32_t entry = next[i], out = leave[i] > entry ? leave[i] : entry;
            const int32_t a = first + sign * entry, b = first + sign * out;
            const uint32_t from = (uint32_t)(a < b ? a : b), to = (uint32_t)(a < b ? b : a);
            const uint32_t above = UINT32_MAX << (from & 31u), below = UINT32_MAX >> (31u - (to & 31u));
            const uint32_t apart = 0u - (uint32_t)(from / WORD != to / WORD);
            word[i] = from / WORD;
            last[i] = to / WORD;
            low[i] = above & (below | apart);
            high[i] = below & apart;
        }
        for (int32_t i = 0; i < count; i++, at_line += beam->stride) {
            uint32_t *const line = bits + at_line;
            uint64_t both;
            memcpy(&both, line + word[i], sizeof both);
            both |= (uint64_t)high[i] << WORD | low[i];
            memcpy(line + word[i], &both, sizeof both);
            if (last[i] > word[i] + 1u) {
                for (uint32_t k = word[i] + 1u; k < last[i]; k++) {
                    line[k] = UINT32_MAX;
                }
                line[last[i]] |= high[i];
            }
        }
        next[0] = next[count];
    }
}
/* Mark all cells of a beam. */
static inline void draw_beam(const ek_window *window, uint32_t *bits, ek_extent slow, ek_extent fast)
{
    const ek_course beam = plot_course(window->words, slow, fast);
    if (EK_IF_WIDE(window->wide) && beam.lines >= SHORT) {
        mark_beam_wide(bits, &beam);
    } else {
        mark_beam(bits, beam);
    }
}

uint32_t ek_window_mark_beams(ek_window *window, const ek_view *view, const ek_real *points, size_t count, int hits)
{
    uint32_t left_out = 0u;
    const ek_real limit = (ek_real)window->lines;
    const int32_t column = (int32_t)view->start_x, row = (int32_t)view->start_y;
    ek_marks marks = window->marks;
    EK_COUNT(EK_STEPS, count);
    for (size_t i = 0; i < count; i++) {
        const ek_real u = points[2u * i], v = points[2u * i + 1u];
        const ek_real x = view->c * u - view->s * v + view->x, y = view->s * u + view->c * v + view->y;
        if (!(x >= EK_R(0.0) && y >= EK_R(0.0) && x < limit && y < limit)) {
            left_out++;
            continue;
        }
        const ek_extent columns = {view->start_x, x, column, (int32_t)x}, rows = {view->start_y, y, row, (int32_t)y};
        const int32_t wide = columns.last > column ? columns.last - column : column - columns.last;
        const int32_t high = rows.last > row ? rows.last - row : row - rows.last;
        const uint32_t left = (uint32_t)(columns.last < column ? columns.last : column), right = left + (uint32_t)wide;
        ek_marks_extend(&marks, (uint32_t)columns.last, (uint32_t)rows.last);
        if (wide >= high) {
            draw_beam(window, window->across, rows, columns);
        } else {
            window->steep_left = left < window->steep_left ? left : window->steep_left;
            window->steep_right = right > window->steep_right ? right : window->steep_right;
            draw_beam(window, window->along, columns, rows);
        }
        if (hits) {
            window->ends[(size_t)rows.last * window->words + (size_t)columns.last / WORD] |=
                (uint32_t)1 << ((uint32_t)columns.last % WORD);
        }
    }
    if (left_out < count) {
        ek_marks_extend(&marks, (uint32_t)column, (uint32_t)row);
        window->marks = marks;
    }
    return left_out;
}

/* Transposes 32 x 32 bits: bit i of word k becomes bit k of word i (Warren, Hacker's Delight, 7-3). */
static void transpose(uint32_t block[WORD])
{
    uint32_t mask = 0x0000FFFFu;
    for (uint32_t half = WORD / 2u; half != 0u; half /= 2u, mask ^= mask << half) {
        for (uint32_t k = 0; k < WORD; k = ((k | half) + 1u) & ~half) {
            const uint32_t swap = ((block[k] >> half) ^ block[k | half]) & mask;
            block[k] ^= swap << half;
            block[k | half] ^= swap;
        }
    }
}

void ek_window_read_block(const ek_window *window, uint32_t row, uint32_t word, uint32_t crossed[EK_WORD])
{
    uint32_t any = 0u;
    for (uint32_t k = 0; k < WORD; k++) {
        crossed[k] = window->along[(size_t)(word * WORD + k) * window->words + row / WORD];
        any |= crossed[k];
    }
    if (any) {
        transpose(crossed);
    }
    for (uint32_t k = 0; k < WORD; k++) {
        crossed[k] |= window->across[(size_t)(row + k) * window->words + word];
    }
}

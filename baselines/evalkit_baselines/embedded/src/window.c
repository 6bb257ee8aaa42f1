#include "ek/window.h"
#include "ek/tally.h"

#include <string.h>

#define WORD EK_WORD

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

/* Mark all cells of a beam that crosses no more lines of the slow axis than of the fast axis; `bits` holds one line
 * along the fast axis for each cell of the slow axis. A beam exactly through a corner goes diagonally. */
static void mark_beam(uint32_t *bits, uint32_t words, ek_extent slow, ek_extent fast)
{
    const int32_t lines = slow.last > slow.first ? slow.last - slow.first : slow.first - slow.last;
    const int32_t cells = fast.last > fast.first ? fast.last - fast.first : fast.first - fast.last;
    const int up = slow.last > slow.first, right = fast.last >= fast.first;
    const ek_real reach = EK_FABS(slow.to - slow.from);
    const ek_real slope = lines ? EK_FABS(fast.to - fast.from) / reach : EK_R(0.0);
    /* 0 to 1, from the cell edge behind the start; either direction is valid for an axis that the beam does not cross
     */
    const ek_real behind = up ? slow.from - (ek_real)slow.first : (ek_real)(slow.first + 1) - slow.from;
    const int forward = fast.to >= fast.from;
    const ek_real start = forward ? fast.from - (ek_real)fast.first : (ek_real)(fast.first + 1) - fast.from;
    const ptrdiff_t stride = up ? (ptrdiff_t)words : -(ptrdiff_t)words;
    ptrdiff_t line = (ptrdiff_t)slow.first * (ptrdiff_t)words;
    int32_t entry = 0;
    for (int32_t k = 1; k <= lines + 1; k++, line += stride) {
        const ek_real at = ((ek_real)k - behind) * slope + start;
        const int32_t next =
            at < (ek_real)cells ? (int32_t)at : cells; /* rounding must not extend a beam past its end */
        int32_t leave = next - ((ek_real)next == at ? 1 : 0);
        leave = k > lines ? cells : leave < entry ? entry : leave;
        mark(bits + line, (uint32_t)(right ? fast.first + entry : fast.first - leave),
             (uint32_t)(right ? fast.first + leave : fast.first - entry));
        entry = next;
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
            mark_beam(window->across, window->words, rows, columns);
        } else {
            window->steep_left = left < window->steep_left ? left : window->steep_left;
            window->steep_right = right > window->steep_right ? right : window->steep_right;
            mark_beam(window->along, window->words, columns, rows);
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

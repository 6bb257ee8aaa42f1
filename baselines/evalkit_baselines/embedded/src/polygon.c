#include "ek/polygon.h"
#include "ek/tally.h"

#define WORD EK_WORD
#define STEEP EK_R(3.0)  /* a longer beam is cut where it exceeds the shorter by this multiple of their distance ... */
#define JUMP EK_R(2.0)   /* ... and this number of cells */
#define TURN EK_R(4.0)   /* a full turn, as pseudo-angle */

/* A beam's end in cells of the window, relative to the start. */
typedef struct {
    ek_real x, y, range, angle; /* angle: grows with the angle, 0 to 4 */
    uint32_t column, row;
} beam_end;

/* The outline so far. */
typedef struct {
    ek_window *window;
    const ek_view *view;
    ek_real direction;         /* 1: counter-clockwise, -1 */
    ek_real turned;            /* pseudo-angle of the outline so far */
    ek_real x, y;              /* its last corner, relative to the start */
    int32_t low, high;         /* its rows: first and last */
} outline;

/* Transform a point to cells relative to the start; 0 if it lies outside the window. */
static int locate(const ek_window *window, const ek_view *view, const ek_real *point, beam_end *end)
{
    const ek_real x = view->c * point[0] - view->s * point[1] + view->x;
    const ek_real y = view->s * point[0] + view->c * point[1] + view->y;
    const ek_real limit = (ek_real)window->lines;
    if (!(x >= EK_R(0.0) && y >= EK_R(0.0) && x < limit && y < limit)) {
        return 0;
    }
    end->column = (uint32_t)(int32_t)x;
    end->row = (uint32_t)(int32_t)y;
    end->x = x - view->start_x;
    end->y = y - view->start_y;
    end->range = EK_SQRT(end->x * end->x + end->y * end->y);
    const ek_real sum = EK_FABS(end->x) + EK_FABS(end->y), part = sum > EK_R(0.0) ? end->x / sum : EK_R(1.0);
    end->angle = end->y >= EK_R(0.0) ? EK_R(1.0) - part : EK_R(3.0) + part;
    return 1;
}

/* Add an edge of the outline: flip, in each row whose centre it passes, the first cell whose centre lies behind it. */
static void add_edge(outline *line, ek_real x, ek_real y)
{
    ek_window *const window = line->window;
    const int up = y > line->y;
    const ek_real low_x = (up ? line->x : x) + line->view->start_x, low_y = (up ? line->y : y) + line->view->start_y;
    const ek_real high_x = (up ? x : line->x) + line->view->start_x, high_y = (up ? y : line->y) + line->view->start_y;
    const int32_t from = (int32_t)(low_y + EK_R(0.5)), to = (int32_t)(high_y + EK_R(0.5)); /* centres not below */
    line->x = x;
    line->y = y;
    EK_COUNT(EK_STEPS, 1u + (uint32_t)(to > from ? to - from : 0));
    if (from >= to) {
        return;
    }
    const ek_real slope = (high_x - low_x) / (high_y - low_y), limit = (ek_real)window->lines;
    line->low = from < line->low ? from : line->low;
    line->high = to - 1 > line->high ? to - 1 : line->high;
    for (int32_t row = from; row < to; row++) {
        const ek_real at = low_x + ((ek_real)row + EK_R(0.5) - low_y) * slope + EK_R(0.5);
        const uint32_t cell = at < limit ? (uint32_t)(int32_t)at : window->lines; /* both ends lie in the window: at > 0 */
        if (cell < window->lines) {
            window->outline[(size_t)row * window->words + cell / WORD] ^= (uint32_t)1 << (cell % WORD);
        }
    }
}

/* Mark the cells inside the outline, an odd number of edges from the left, and begin a new one. An edge ends the cells
 * before its own, and may lie one cell beyond all marks. */
static void fill(outline *line)
{
    ek_window *const window = line->window;
    const uint32_t last = window->marks.right / WORD + 1u, words = last < window->words ? last + 1u : window->words;
    add_edge(line, EK_R(0.0), EK_R(0.0));
    for (int32_t row = line->low; row <= line->high; row++) {
        EK_COUNT(EK_WORDS, words - window->marks.left / WORD);
        uint32_t *const edges = window->outline + (size_t)row * window->words;
        uint32_t *const across = window->across + (size_t)row * window->words, carry = 0u;
        for (uint32_t word = window->marks.left / WORD; word < words; word++) {
            uint32_t bits = edges[word];
            bits ^= bits << 1;
            bits ^= bits << 2;
            bits ^= bits << 4;
            bits ^= bits << 8;
            bits ^= bits << 16;
            bits ^= carry;
            carry = bits >> (WORD - 1u) ? UINT32_MAX : 0u;
            across[word] |= bits;
            edges[word] = 0u;
        }
    }
    line->turned = EK_R(0.0);
    line->low = (int32_t)window->lines;
    line->high = -1;
}

/* Pseudo-angle from one end to the next in the direction of the scan, 0 to 4. */
static ek_real turn_between(const beam_end *from, const beam_end *to, ek_real direction)
{
    const ek_real turn = direction * (to->angle - from->angle);
    return turn < EK_R(0.0) ? turn + TURN : turn;
}

/* Add the area between two beams. Returns which of them it reaches: 1 the first, 2 the second. */
static int add_wedge(outline *line, const beam_end *from, const beam_end *to, ek_real narrowest)
{
    const ek_real cross = line->direction * (from->x * to->y - from->y * to->x);
    const ek_real dot = from->x * to->x + from->y * to->y, product = from->range * to->range;
    const ek_real turn = turn_between(from, to, line->direction);
    const int gap = !(cross > EK_R(0.0) && dot >= narrowest * product);
    if (cross < EK_R(0.0) || line->turned + turn >= TURN) { /* areas must not overlap */
        fill(line);
        add_edge(line, from->x, from->y);
    }
    line->turned = line->turned + turn < TURN ? line->turned + turn : EK_R(0.0);
    if (gap) {
        add_edge(line, EK_R(0.0), EK_R(0.0));
        add_edge(line, to->x, to->y);
        return 0;
    }
    const ek_real longer = from->range > to->range ? from->range : to->range;
    const ek_real jump = EK_FABS(from->range - to->range);
    if (jump <= STEEP * cross / longer + JUMP) {
        add_edge(line, to->x, to->y);
        return 3;
    }
    const beam_end *const cut = from->range > to->range ? from : to;
    const ek_real share = (from->range > to->range ? to->range : from->range) / cut->range;
    add_edge(line, share * cut->x, share * cut->y);
    add_edge(line, to->x, to->y);
    return cut == from ? 2 : 1;
}

/* 1 if more neighbouring beams turn counter-clockwise than clockwise, otherwise -1. */
static ek_real find_direction(const ek_window *window, const ek_view *view, const ek_real *points, size_t count)
{
    beam_end last = {0}, next;
    int known = 0, balance = 0;
    for (size_t i = 0; i < count; i++) {
        if (locate(window, view, points + 2u * i, &next)) {
            const ek_real cross = known ? last.x * next.y - last.y * next.x : EK_R(0.0);
            balance += (cross > EK_R(0.0)) - (cross < EK_R(0.0));
            last = next;
            known = 1;
        }
    }
    return balance >= 0 ? EK_R(1.0) : EK_R(-1.0);
}

static void mark_hit(ek_window *window, const beam_end *end)
{
    ek_marks_extend(&window->marks, end->column, end->row);
    window->ends[(size_t)end->row * window->words + end->column / WORD] |= (uint32_t)1 << (end->column % WORD);
}

uint32_t ek_window_fill_outline(ek_window *window, const ek_view *view, const ek_real *points, size_t count,
                                ek_real widest_gap)
{
    outline line = {window, view, find_direction(window, view, points, count), EK_R(0.0), EK_R(0.0), EK_R(0.0),
                    (int32_t)window->lines, -1};
    const ek_real narrowest = EK_COS(widest_gap);
    EK_COUNT(EK_CORNERS, count);
    ek_marks_extend(&window->marks, (uint32_t)(int32_t)view->start_x, (uint32_t)(int32_t)view->start_y);
    beam_end first = {0}, last = {0}, next;
    uint32_t left_out = 0u;
    size_t first_beam = count, last_beam = count;
    int reached = 0, first_reached = 0;
    for (size_t i = 0; i <= count; i++) { /* at the end the first beam again: it closes a full turn */
        const int closing = i == count;
        if (closing && first_beam == last_beam) {
            break;
        }
        if (closing) {
            next = first;
        } else if (!locate(window, view, points + 2u * i, &next)) {
            left_out++;
            continue;
        } else {
            mark_hit(window, &next);
        }
        if (last_beam == count) {
            first = next;
            first_beam = i;
            add_edge(&line, next.x, next.y);
        } else {
            const int wedge = add_wedge(&line, &last, &next, narrowest);
            if (last_beam == first_beam) {
                first_reached = wedge & 1;
            } else if (!(reached && (wedge & 1))) {
                (void)ek_window_mark_beams(window, view, points + 2u * last_beam, 1u, 0);
            }
            reached = wedge & 2;
        }
        last = next;
        last_beam = i;
    }
    if (first_beam < count && !(first_reached && reached)) {
        (void)ek_window_mark_beams(window, view, points + 2u * first_beam, 1u, 0);
    }
    fill(&line);
    return left_out;
}

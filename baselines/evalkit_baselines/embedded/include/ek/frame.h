/* frame.h - the square cells laid over a cloud. */
#ifndef EK_FRAME_H
#define EK_FRAME_H

#include "ek/real.h"
#include "ek/status.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What a cloud spans (m). */
typedef struct {
    ek_real left, right, bottom, top;
} ek_span;

typedef struct {
    uint32_t columns, rows;
    ek_real left, bottom;      /* lower left corner (m) */
    ek_real cell, per_cell;    /* cell width (m) and its inverse */
    ek_real margin;            /* what rounding can do to a distance (m) */
    int finest;                /* 1: there is no memory for smaller cells, or they would be too small */
} ek_frame;

#define ek_span_of EK_NAME(span_of)
#define ek_frame_over EK_NAME(frame_over)
#define ek_frame_holds EK_NAME(frame_holds)
#define ek_frame_spare EK_NAME(frame_spare)
#define ek_frame_suits EK_NAME(frame_suits)

/* What count pairs x y span; without any, nothing (right below left). EK_NOT_FINITE; EK_OUT_OF_RANGE: a coordinate
 * beyond EK_LARGEST. */
ek_status ek_span_of(const ek_real *xy, size_t count, ek_span *span);

/* Cells of a given width (m), or of the next wider one of which `most` (1 or more) are enough, over a cloud and some
 * room around it: a sixteenth of its width and height on each side, a quarter of that where so much would need wider
 * ones. */
ek_frame ek_frame_over(const ek_span *span, ek_real cell, size_t most);

/* Whether it has room for all that a cloud spans. A frame of zeros has none. */
int ek_frame_holds(const ek_frame *frame, const ek_span *span);

/* So many of `lines` columns or rows must not lie empty along a side. */
static inline uint32_t ek_frame_spare(uint32_t lines)
{
    return lines / 4u + 1u;
}

/* Whether it holds what a cloud spans and is not much too large for it. */
int ek_frame_suits(const ek_frame *frame, const ek_span *span);

/* The cell, row after row, of a pair x y that the frame holds. */
static inline uint32_t ek_frame_cell(const ek_frame *frame, const ek_real *xy)
{
    /* not negative and below 2^20, so that signed conversions do, which processors have */
    const uint32_t column = (uint32_t)(int32_t)((xy[0] - frame->left) * frame->per_cell);
    const uint32_t row = (uint32_t)(int32_t)((xy[1] - frame->bottom) * frame->per_cell);
    return row * frame->columns + column;
}

#ifdef __cplusplus
}
#endif
#endif

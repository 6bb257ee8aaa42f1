#include "ek/frame.h"

#include <string.h>

#define MAX_ACROSS EK_R(1048576) /* cells: a float still tells them apart */
#define MIN_CELL EK_R(1e-3) /* m */
#define ROOM EK_R(0.0625) /* of a cloud's width and height, on each side: until a local map leaves it, its frame stays */
#define LITTLE_ROOM EK_R(0.015625) /* the same where more would need wider cells */
#define WIDER EK_R(1.1)

ek_status ek_span_of(const ek_real *xy, size_t count, ek_span *span)
{
    ek_real left = EK_LARGEST, right = -EK_LARGEST, bottom = EK_LARGEST, top = -EK_LARGEST;
    for (size_t i = 0; i < count; i++) {
        const ek_real x = xy[2u * i], y = xy[2u * i + 1u];
        if (!(EK_FABS(x) <= EK_LARGEST && EK_FABS(y) <= EK_LARGEST)) {
            return isfinite(x) && isfinite(y) ? EK_OUT_OF_RANGE : EK_NOT_FINITE;
        }
        left = x < left ? x : left;
        right = x > right ? x : right;
        bottom = y < bottom ? y : bottom;
        top = y > top ? y : top;
    }
    span->left = left;
    span->right = right;
    span->bottom = bottom;
    span->top = top;
    return EK_OK;
}

/* Lays cells over a cloud and a share of its width and height around it, if `most` are enough. */
static int lay(ek_frame *frame, const ek_span *span, ek_real cell, ek_real share, size_t most)
{
    const ek_real per_cell = EK_R(1.0) / cell;
    const ek_real beside = EK_FLOOR(share * (span->right - span->left) * per_cell);
    const ek_real below = EK_FLOOR(share * (span->top - span->bottom) * per_cell);
    const ek_real left = span->left - beside * cell, bottom = span->bottom - below * cell;
    const ek_real columns = EK_FLOOR((span->right - left) * per_cell) + EK_R(1.0) + beside;
    const ek_real rows = EK_FLOOR((span->top - bottom) * per_cell) + EK_R(1.0) + below;
    if (!(columns <= MAX_ACROSS && rows <= MAX_ACROSS) || (uint64_t)columns * (uint64_t)rows > most) {
        return 0;
    }
    const ek_real right = left + columns * cell, top = bottom + rows * cell;
    const ek_real far_x = EK_FABS(left) > EK_FABS(right) ? EK_FABS(left) : EK_FABS(right);
    const ek_real far_y = EK_FABS(bottom) > EK_FABS(top) ? EK_FABS(bottom) : EK_FABS(top);
    frame->columns = (uint32_t)columns;
    frame->rows = (uint32_t)rows;
    frame->left = left;
    frame->bottom = bottom;
    frame->cell = cell;
    frame->per_cell = per_cell;
    frame->margin = EK_R(16.0) * EK_EPSILON * (EK_R(1.0) + far_x + far_y);
    return 1;
}

ek_frame ek_frame_over(const ek_span *span, ek_real cell, size_t most)
{
    ek_frame frame;
    memset(&frame, 0, sizeof frame);
    frame.finest = cell <= MIN_CELL;
    cell = frame.finest ? MIN_CELL : cell;
    if (lay(&frame, span, cell, ROOM, most)) {
        return frame;
    }
    while (!lay(&frame, span, cell, LITTLE_ROOM, most)) {
        cell *= WIDER;
        frame.finest = 1;
    }
    return frame;
}

int ek_frame_holds(const ek_frame *frame, const ek_span *span)
{
    return span->left >= frame->left && (span->right - frame->left) * frame->per_cell < (ek_real)frame->columns &&
           span->bottom >= frame->bottom && (span->top - frame->bottom) * frame->per_cell < (ek_real)frame->rows;
}

int ek_frame_suits(const ek_frame *frame, const ek_span *span)
{
    if (!ek_frame_holds(frame, span)) {
        return 0;
    }
    const uint32_t across = ek_frame_spare(frame->columns), up = ek_frame_spare(frame->rows);
    return (uint32_t)((span->left - frame->left) * frame->per_cell) < across &&
           (uint32_t)((span->right - frame->left) * frame->per_cell) + across >= frame->columns &&
           (uint32_t)((span->bottom - frame->bottom) * frame->per_cell) < up &&
           (uint32_t)((span->top - frame->bottom) * frame->per_cell) + up >= frame->rows;
}

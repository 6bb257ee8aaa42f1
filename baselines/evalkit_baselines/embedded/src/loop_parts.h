/* loop_parts.h - parts of loop_finder.h that loop_finder.c and loop_judge.c share. */
#ifndef EK_LOOP_PARTS_H
#define EK_LOOP_PARTS_H

#include "ek/loop_finder.h"
#include "ek/normals.h"

#define ek_loop_is_possible EK_NAME(loop_is_possible)
#define ek_loop_judge EK_NAME(loop_judge)

/* 1 if a motion lies within twice the gate of what the graph predicts. */
int ek_loop_is_possible(const ek_loop_finder *finder, ek_pose motion);

/* Phase EK_FINDER_JUDGE: overlap, observability and chi-square of the match. At most 200 operations a point. */
void ek_loop_judge(ek_loop_finder *finder, ek_work *work);

#endif

/* loop_parts.h - parts of loop_finder.h: loop_places.c (which place is next), loop_finder.c (search), loop_judge.c (verdict). */
#ifndef EK_LOOP_PARTS_H
#define EK_LOOP_PARTS_H

#include "ek/loop_finder.h"
#include "ek/normals.h"

#define ek_loop_is_possible EK_NAME(loop_is_possible)
#define ek_loop_judge EK_NAME(loop_judge)
#define ek_loop_look EK_NAME(loop_look)
#define ek_loop_part EK_NAME(loop_part)

/* 1 if a motion lies within twice the gate of what the graph predicts. */
int ek_loop_is_possible(const ek_loop_finder *finder, ek_pose motion);

/* Share of the score and of the overlap that is enough where the maps lie on each other in part; 1: all. */
ek_real ek_loop_part(const ek_loop_finder *finder);

/* Phase EK_FINDER_JUDGE: overlap, observability and chi-square of the match. At most 200 operations a point. */
void ek_loop_judge(ek_loop_finder *finder, ek_work *work);

/* Phase EK_FINDER_LOOK: which points that are missing on the target its scans could see, a keyframe in a part. */
void ek_loop_look(ek_loop_finder *finder, const ek_keyframes *keyframes, ek_work *work);

#endif

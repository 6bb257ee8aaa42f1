/* work.h - count operations, so that a task can stop after a bounded amount of work and go on with the next scan.
 *
 * An operation is one pass of an innermost loop: a point looked up, moved or compared, a row of a small matrix. It takes 1
 * to 5 ns on a desktop processor. A slice ends at the first pause between two parts after its operations are used up;
 * each header says how many operations one part has at most.
 */
#ifndef EK_WORK_H
#define EK_WORK_H

#include "ek/tally.h"

#include <stdint.h>

#define EK_MATCH_WORK 12u /* operations for a point in an iteration of ICP */

typedef struct {
    int64_t left;  /* operations; not positive: stop */
    uint64_t done; /* operations so far */
} ek_work;

static inline ek_work ek_work_make(int64_t operations)
{
    const ek_work work = {operations, 0u};
    return work;
}

/* Spend the operations of loops that have tallies of their own (tally.h). */
static inline void ek_work_spend_tallied(ek_work *work, uint64_t operations)
{
    work->done += operations;
    work->left = operations < (uint64_t)INT64_MAX && work->left > INT64_MIN + (int64_t)operations
                     ? work->left - (int64_t)operations
                     : INT64_MIN;
}

static inline void ek_work_spend(ek_work *work, uint64_t operations)
{
    EK_COUNT(EK_OPERATIONS, operations);
    ek_work_spend_tallied(work, operations);
}

#endif

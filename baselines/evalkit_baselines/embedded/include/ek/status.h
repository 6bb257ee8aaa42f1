/* status.h - return codes.
 *
 * A function that a program calls returns EK_NULL_POINTER where a pointer that it needs is NULL; those that only the core calls
 * do not check that. The comment of a function names its other codes. After an error, what it should have returned through a
 * pointer is undefined, unless that comment says otherwise.
 */
#ifndef EK_STATUS_H
#define EK_STATUS_H

#include "ek/real.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
    EK_OK = 0,
    EK_NULL_POINTER,      /* a pointer that is needed is NULL */
    EK_NOT_FINITE,        /* a number is nan or infinite */
    EK_NO_POINTS,         /* there are none, and some are needed */
    EK_TOO_MANY_POINTS,   /* or beams: more than the capacity given at the start */
    EK_OUT_OF_RANGE,      /* a parameter, coordinate or stamp */
    EK_TOO_LITTLE_MEMORY, /* or memory that is not aligned to EK_ALIGNMENT */
    EK_BAD_FILE,          /* no log of this version, or cut off (scanlog.h) */
    EK_END_OF_FILE,       /* no more scans (scanlog.h) */
    EK_STATUS_COUNT
} ek_status;

#define ek_status_text EK_NAME(status_text)

/* Describe a status in English, without a full stop; "unknown status" for any other number. Never NULL. */
const char *ek_status_text(ek_status status);

#ifdef __cplusplus
}
#endif
#endif

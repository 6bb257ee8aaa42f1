/* status.h - return codes. */
#ifndef EK_STATUS_H
#define EK_STATUS_H

#include "ek/real.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
    EK_OK = 0,
    EK_NULL_POINTER,
    EK_NOT_FINITE,
    EK_NO_POINTS,
    EK_TOO_MANY_POINTS,
    EK_OUT_OF_RANGE,
    EK_TOO_LITTLE_MEMORY,
    EK_BAD_FILE,
    EK_END_OF_FILE,
    EK_STATUS_COUNT
} ek_status;

#define ek_status_text EK_NAME(status_text)

/* Describe a status in English, without a full stop; "unknown status" for any other number. Never NULL. */
const char *ek_status_text(ek_status status);

#ifdef __cplusplus
}
#endif
#endif

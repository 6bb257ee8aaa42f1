#include "ek/status.h"

const char *ek_status_text(ek_status status)
{
    static const char *const texts[EK_STATUS_COUNT] = {
        "no error",
        "a required pointer is NULL",
        "a number that must be finite is nan or infinite",
        "there are no points",
        "more points or beams than the capacity given at initialisation",
        "a parameter is outside its range",
        "the given memory is too small or not aligned to 16 bytes",
        "the file is not an evalkit scan log of this version or is truncated",
        "the file has no more scans",
    };
    if ((unsigned)status >= (unsigned)EK_STATUS_COUNT) {
        return "unknown status";
    }
    return texts[status];
}

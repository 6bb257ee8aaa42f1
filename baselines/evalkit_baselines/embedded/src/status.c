#include "ek/status.h"

const char *ek_status_text(ek_status status)
{
    static const char *const texts[EK_STATUS_COUNT] = {
        "all is well",
        "a pointer that must lead somewhere is NULL",
        "a number is nan or infinite where it must be finite",
        "there are no points to work on",
        "more points or beams than the capacity given at the start",
        "a parameter lies outside its range",
        "the memory handed in is too small or not aligned to 16 bytes",
        "the file is not an evalkit scan log of this version or is cut short",
        "the file has no more scans",
    };
    if ((unsigned)status >= (unsigned)EK_STATUS_COUNT) {
        return "unknown status";
    }
    return texts[status];
}

/* Arbitrary files: evalkit-run reads, locates and maps them, or refuses them. */
#define main evalkit_run
#include "../main.c"
#undef main

#include "input.h"

#define MAX_BEAMS 512u
#define LONGEST EK_R(30.0) /* m; a longer range needs too much memory for fuzzing */

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    static session s;
    static char lines[1u << 16], log_path[] = "log", poses_path[] = "poses";
    char *const paths[] = {log_path, poses_path}; /* in messages only */
    memset(&s, 0, sizeof s);
    FILE *const input = size ? fmemopen((void *)(uintptr_t)bytes, size, "rb") : NULL;
    FILE *const poses = fmemopen(lines, sizeof lines, "w");
    HOLDS(poses != NULL);
    if (input && ek_scanlog_open(input, &s.log) == EK_OK && s.log.max_beams <= MAX_BEAMS &&
        !(s.log.range_max > LONGEST) && start(&s, log_path) == 0) {
        run(&s, input, poses, paths);
        HOLDS(ftell(poses) >= 0);
    }
    if (input) {
        fclose(input);
    }
    fclose(poses);
    const char *line = lines;
    long long seconds, nanoseconds;
    for (int moved; sscanf(line, "%lld.%9lld %*f %*f 0 0 0 %*f %*f\n%n", &seconds, &nanoseconds, &moved) == 2;
         line += moved) {
        HOLDS(nanoseconds >= 0);
    }
    lines[0] = '\0';
    free(s.memory);
    free(s.ranges);
    free(s.angles);
    return 0;
}

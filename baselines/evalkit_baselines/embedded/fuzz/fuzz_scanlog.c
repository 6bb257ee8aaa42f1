/* Arbitrary files: evalkit-run reads, locates and maps them, or refuses them; every fourth size of file with the SLAM. */
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
    s.paths = paths;
    s.use_slam = size % 4u == 0u;
    s.input = size ? fmemopen((void *)(uintptr_t)bytes, size, "rb") : NULL;
    s.poses = fmemopen(lines, sizeof lines, "w");
    HOLDS(s.poses != NULL);
    if (s.input && ek_scanlog_open(s.input, &s.log) == EK_OK && s.log.max_beams <= MAX_BEAMS &&
        !(s.log.range_max > LONGEST) && take_beams(&s) == 0) {
        (void)(s.use_slam ? run_slam(&s, 1) : run_pipeline(&s));
        HOLDS(ftell(s.poses) >= 0);
    }
    if (s.input) {
        fclose(s.input);
    }
    fclose(s.poses);
    const char *line = lines;
    long long seconds, nanoseconds;
    for (int moved; sscanf(line, "%lld.%9lld %*f %*f 0 0 0 %*f %*f\n%n", &seconds, &nanoseconds, &moved) == 2;
         line += moved) {
        HOLDS(nanoseconds >= 0);
    }
    lines[0] = '\0';
    free_memory(&s);
    return 0;
}

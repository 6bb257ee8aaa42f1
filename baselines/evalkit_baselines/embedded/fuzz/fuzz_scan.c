/* Arbitrary scans: points are finite and within bounds, or the scan is refused and empty. */
#include "ek/scan.h"
#include "input.h"

#define MAX_COUNT 40u

static void project(ek_scan *scan, ek_input *input)
{
    ek_sweep sweep;
    ek_scan_parameters parameters;
    memset(&sweep, 0, sizeof sweep);
    sweep.beams = take_byte(input) % (MAX_COUNT + 2u);
    ek_real *const ranges = take_reals(input, sweep.beams), *const angles = take_reals(input, sweep.beams);
    sweep.ranges = take_byte(input) == 255u ? NULL : ranges;
    sweep.angles = angles;
    parameters.base_from_sensor = take_pose(input);
    parameters.range_min = take_real(input);
    parameters.range_max = take_real(input);
    parameters.local_radius = take_byte(input) % 2u ? take_real(input) : EK_R(0.0);
    const ek_pose motion = take_pose(input);
    const ek_status status = ek_scan_project(scan, &sweep, &parameters, take_byte(input) % 4u ? &motion : NULL);
    HOLDS(status == EK_OK || scan->count + scan->misses == 0u || sweep.ranges == NULL);
    HOLDS(scan->count + scan->misses <= sweep.beams || status != EK_OK);
    if (status == EK_OK) {
        for (size_t i = 0; i < 2u * scan->count; i++) {
            HOLDS(EK_FABS(scan->hits[i]) <= EK_MAX_COORDINATE * (EK_R(1.0) + EK_EPSILON));
        }
        for (size_t i = 0; i < 2u * scan->misses; i++) {
            HOLDS(isfinite(scan->ends[i]));
        }
    }
    free(ranges);
    free(angles);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    ek_input input = {bytes, size};
    ek_scan scan;
    ek_arena measured = ek_arena_make(NULL, 0u);
    HOLDS(ek_scan_init(&scan, &measured, MAX_COUNT) == EK_OK);
    ek_arena arena = memory_for(&measured);
    HOLDS(ek_scan_init(&scan, &arena, MAX_COUNT) == EK_OK && ek_arena_check(&arena) == EK_OK);
    for (int scans = 0; scans < 3 && input.left; scans++) {
        project(&scan, &input);
    }
    free(arena.memory);
    return 0;
}

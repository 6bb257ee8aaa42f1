/* Example firmware: the core's registration, its pipeline and its SLAM behind a serial line, without a heap. To validate
 * another implementation, replace create_session, register_clouds and update_pose, and of a SLAM correct_poses and
 * list_closures; `python -m evalkit.external.serial_board` is the host's side.
 *
 * A message is a type and numbers without gaps, little-endian. An answer is 'a' and numbers, or 'f' and a text.
 *     H                                        -> u16 version, u8 bytes of a real, u8 0, u32 largest scan,
 *                                                 u32 largest target, text (see `about`)
 *     C  u8 kind ('r', 'o', 's')  f64 parameters[] of this kind
 *                                              -> u32 bytes of memory used
 *     R  f64 guess[3]  u32 source, target  real source[2 x n], target[2 x m]
 *                                              -> f64 pose[3], error, u32 converged, iterations, inliers
 *                                                 u64 nanoseconds
 *     U  f64 range_min, range_max, base_from_sensor[3]  i64 stamp_ns, time_increment_ns  u32 beams, flags (scanlog.h)
 *        f64 odom_from_base[3], start_from_end[3] (as flagged)  real ranges[n], angles[n]
 *                                              -> f64 pose[3], u64 nanoseconds; of a SLAM also
 *                                                 u32 keyframe, f64 odom_from_base[3], u32 corrected
 *     T  u32 scans  {u32 keyframe  f64 odom_from_base[3]}[]: at most POSES scans of a SLAM, as U has answered
 *                                              -> f64 pose[3] of each, corrected
 *     L  u32 first                             -> u32 candidates for loops of a SLAM, and at most CLOSURES of them from
 *                                                 `first` on: u32 later, earlier keyframe, f64 pose[3], number[2], u32 outcome
 *                                                 (loop_finder.h), u32 flags (1: accepted, 2: not confirmed, 4: found again,
 *                                                 8: withdrawn, 16: no room)
 */
#include <string.h>

#include "ek/pipeline.h"
#include "link.h"
#include "message.h"
#include "port.h"
#include "small_slam.h"

#ifndef BOARD_POINTS
#define BOARD_POINTS 2048u /* of a scan or source */
#endif
#ifndef BOARD_KEYFRAMES
#define BOARD_KEYFRAMES 10u
#endif
#ifndef BOARD_CELLS
#define BOARD_CELLS 0u /* of the index of the local map; 0: 16 per point */
#endif
#ifndef BOARD_BYTES
#define BOARD_BYTES (8u << 20) /* for the method */
#endif
#ifndef BOARD_SLAM_KEYFRAMES
#define BOARD_SLAM_KEYFRAMES 300u /* of 200 points in the mean */
#endif
#define BOARD_TARGETS (BOARD_POINTS * BOARD_KEYFRAMES)
#define TARGET_CELLS ((size_t)1 << 16)
#define VERSION 3u
#define POSES 20u
#define CLOSURES 8u
#define MESSAGE_BYTES (64u + 2u * sizeof(ek_real) * (BOARD_POINTS + BOARD_TARGETS))

/* Kinds of sessions, a summary, and a line for each parameter: the kinds that take it, its name and its default. */
static const char about[] = "ros\n"
                            "the core of evalkit as firmware\n"
                            "ro max_iterations 40\n"
                            "ro min_pairs 3\n"
                            "ro epsilon 1e-4\n"
                            "ro max_correspondence_m 0.3\n"
                            "ro one_to_one true\n"
                            "s work 200000\n";

static unsigned char message[MESSAGE_BYTES];
static union {
    unsigned char bytes[BOARD_BYTES];
    double align[2];
} memory __attribute__((aligned(16)));
static ek_real points[2u * (BOARD_POINTS + BOARD_TARGETS)];
static link_state line;
static ek_icp_parameters matching;
static ek_icp icp;
static ek_index target;
static ek_pipeline pipeline;
static ek_slam slam;
static char kind; /* of the session; 0: none */
static size_t needed; /* bytes of memory of the last session that was asked for */

static void say_hello(writer *out)
{
    put_unsigned(out, VERSION, 2u);
    put_unsigned(out, sizeof(ek_real), 1u);
    put_unsigned(out, 0u, 1u);
    put_unsigned(out, BOARD_POINTS, 4u);
    put_unsigned(out, BOARD_TARGETS, 4u);
    put_text(out, about);
}

static ek_status start_registration(size_t *bytes)
{
    ek_arena arena = ek_arena_make(memory.bytes, sizeof memory.bytes);
    ek_status status = ek_icp_init(&icp, &arena, BOARD_POINTS, BOARD_TARGETS);
    if (status == EK_OK) {
        status = ek_index_init(&target, &arena, BOARD_TARGETS, TARGET_CELLS);
    }
    *bytes = arena.used;
    return status == EK_OK ? ek_arena_check(&arena) : status;
}

static ek_status start_pipeline(size_t *bytes)
{
    ek_pipeline_parameters parameters = ek_pipeline_default();
    parameters.map = 0;
    parameters.frontend.scan_to_scan = parameters.frontend.scan_to_map = matching;
    parameters.frontend.points = BOARD_POINTS;
    parameters.frontend.keyframes = BOARD_KEYFRAMES;
    parameters.frontend.cells = BOARD_CELLS;
    const ek_status status = ek_pipeline_bytes(&parameters, bytes);
    return status == EK_OK ? ek_pipeline_start(&pipeline, memory.bytes, sizeof memory.bytes, &parameters) : status;
}

static ek_status start_slam(int32_t work, size_t *bytes)
{
    ek_slam_parameters parameters = small_slam(BOARD_POINTS, BOARD_SLAM_KEYFRAMES);
    parameters.work = work;
    const ek_status status = ek_slam_bytes(&parameters, bytes);
    return status == EK_OK ? ek_slam_start(&slam, memory.bytes, sizeof memory.bytes, &parameters) : status;
}

static ek_status start_matching(char wanted, reader *in)
{
    matching = ek_icp_default();
    matching.max_iterations = take_count(in);
    matching.min_pairs = take_count(in);
    matching.epsilon = (ek_real)take_double(in);
    matching.max_correspondence = (ek_real)take_double(in);
    matching.one_to_one = take_double(in) != 0.0;
    if (in->short_by || in->left) {
        return EK_OUT_OF_RANGE;
    }
    const ek_status status = ek_icp_check(&matching);
    return status != EK_OK ? status : wanted == 'r' ? start_registration(&needed) : start_pipeline(&needed);
}

static ek_status create_session(reader *in, writer *out)
{
    const char wanted = (char)take_unsigned(in, 1u);
    ek_status status = EK_OUT_OF_RANGE;
    kind = 0;
    if (wanted == 'r' || wanted == 'o') {
        status = start_matching(wanted, in);
    } else if (wanted == 's') {
        const int32_t work = take_count(in);
        status = in->short_by || in->left ? EK_OUT_OF_RANGE : start_slam(work, &needed);
    }
    kind = status == EK_OK ? wanted : (char)0;
    put_unsigned(out, needed, 4u);
    return status;
}

static ek_status register_clouds(reader *in, writer *out)
{
    const ek_pose guess = take_pose(in);
    const size_t sources = (size_t)take_unsigned(in, 4u), targets = (size_t)take_unsigned(in, 4u);
    if (sources > BOARD_POINTS || targets > BOARD_TARGETS) {
        return EK_TOO_MANY_POINTS;
    }
    take_reals(in, points, 2u * (sources + targets));
    if (in->short_by || in->left) {
        return EK_BAD_FILE;
    }
    if (!ek_se2_is_finite(guess)) { /* without points it is the answer */
        return EK_NOT_FINITE;
    }
    ek_match match = {guess, 0, 0, 0, (ek_real)NAN, 0u};
    const uint64_t begin = port_clock_ns();
    ek_status status = ek_index_build(&target, points + 2u * sources, targets);
    if (status == EK_OK && sources && targets) {
        status = ek_icp_register(&icp, &target, points, sources, guess, &matching, NULL, NULL, &match);
    }
    const uint64_t taken = port_clock_ns() - begin;
    put_pose(out, match.target_from_source);
    put_double(out, (double)match.error);
    put_unsigned(out, (uint64_t)match.converged, 4u);
    put_unsigned(out, (uint64_t)match.iterations, 4u);
    put_unsigned(out, (uint64_t)match.inliers, 4u);
    put_unsigned(out, taken, 8u);
    return status;
}

/* Process a scan with the method of the session, and put its pose and time. */
static ek_status update_method(const ek_sweep *sweep, writer *out)
{
    ek_estimate estimate;
    ek_slam_estimate corrected;
    const uint64_t begin = port_clock_ns();
    const ek_status status = kind == 's' ? ek_slam_update(&slam, sweep, &corrected) : ek_pipeline_update(&pipeline, sweep, &estimate);
    const uint64_t taken = port_clock_ns() - begin;
    if (status == EK_OK) {
        put_pose(out, kind == 's' ? corrected.start_from_base : estimate.start_from_base);
        put_unsigned(out, taken, 8u);
    }
    if (status == EK_OK && kind == 's') {
        put_unsigned(out, corrected.keyframe, 4u);
        put_pose(out, corrected.odom_from_base);
        put_unsigned(out, corrected.corrected != 0, 4u);
    }
    return status;
}

static ek_status update_pose(reader *in, writer *out)
{
    ek_sweep sweep;
    ek_scan_parameters *const scan = kind == 's' ? &slam.parameters.scan : &pipeline.parameters.scan;
    memset(&sweep, 0, sizeof sweep);
    scan->range_min = (ek_real)take_double(in);
    scan->range_max = (ek_real)take_double(in);
    scan->base_from_sensor = take_pose(in);
    sweep.stamp_ns = (int64_t)take_unsigned(in, 8u);
    sweep.time_increment_ns = (int64_t)take_unsigned(in, 8u);
    sweep.beams = (size_t)take_unsigned(in, 4u);
    const uint64_t flags = take_unsigned(in, 4u);
    sweep.has_odometry = (flags & 1u) != 0u;
    sweep.has_motion = (flags & 2u) != 0u;
    if (sweep.has_odometry) {
        sweep.odom_from_base = take_pose(in);
    }
    if (sweep.has_motion) {
        sweep.start_from_end = take_pose(in);
    }
    if (sweep.beams > BOARD_POINTS) {
        return EK_TOO_MANY_POINTS;
    }
    take_reals(in, points, 2u * sweep.beams);
    if (in->short_by || in->left) {
        return EK_BAD_FILE;
    }
    if (sweep.beams == 0u) { /* one invalid beam: a scan without beams is an error of the core */
        points[0] = (ek_real)NAN;
        points[1] = EK_R(0.0);
        sweep.beams = 1u;
    }
    sweep.ranges = points;
    sweep.angles = points + sweep.beams;
    const ek_status status = ek_scan_check(scan);
    return status == EK_OK ? update_method(&sweep, out) : status;
}

static ek_status correct_poses(reader *in, writer *out)
{
    const size_t scans = (size_t)take_unsigned(in, 4u);
    if (scans > POSES) {
        return EK_TOO_MANY_POINTS;
    }
    for (size_t k = 0; k < scans; k++) {
        const uint32_t keyframe = (uint32_t)take_unsigned(in, 4u);
        const ek_pose odom_from_base = take_pose(in);
        if (!ek_se2_is_finite(odom_from_base)) {
            return EK_NOT_FINITE;
        }
        put_pose(out, ek_slam_correct(&slam, keyframe, odom_from_base));
    }
    return in->short_by || in->left ? EK_BAD_FILE : EK_OK;
}

static ek_status list_closures(reader *in, writer *out)
{
    const size_t first = (size_t)take_unsigned(in, 4u);
    if (in->short_by || in->left) {
        return EK_BAD_FILE;
    }
    put_unsigned(out, slam.record_count, 4u);
    for (size_t k = first; k < slam.record_count && k - first < CLOSURES; k++) {
        const ek_loop_record *const now = slam.record + k;
        const uint32_t flags = (now->accepted ? 1u : 0u) | (now->unconfirmed ? 2u : 0u) | (now->found_again ? 4u : 0u) |
                               (now->withdrawn ? 8u : 0u) | (now->no_room ? 16u : 0u);
        put_unsigned(out, now->candidate.edge.second, 4u);
        put_unsigned(out, now->candidate.edge.first, 4u);
        put_pose(out, now->candidate.edge.first_from_second);
        put_double(out, (double)now->candidate.number[0]);
        put_double(out, (double)now->candidate.number[1]);
        put_unsigned(out, (uint64_t)now->candidate.outcome, 4u);
        put_unsigned(out, flags, 4u);
    }
    return EK_OK;
}

static void answer_message(void)
{
    static writer out;
    reader in = {message, line.bytes, 0u};
    const char type = (char)take_unsigned(&in, 1u);
    ek_status status = EK_OK;
    out.count = 0u;
    put_text(&out, "a");
    if (type == 'H') {
        say_hello(&out);
    } else if (type == 'C') {
        status = create_session(&in, &out);
    } else if (type == 'R' && kind == 'r') {
        status = register_clouds(&in, &out);
    } else if (type == 'U' && (kind == 'o' || kind == 's')) {
        status = update_pose(&in, &out);
    } else if (type == 'T' && kind == 's') {
        status = correct_poses(&in, &out);
    } else if (type == 'L' && kind == 's') {
        status = list_closures(&in, &out);
    } else {
        out.count = 0u;
        put_text(&out, "funknown message, or before C");
    }
    if (status != EK_OK) {
        out.count = 0u;
        put_text(&out, "f");
        put_text(&out, ek_status_text(status));
        if (type == 'C' && status == EK_TOO_LITTLE_MEMORY) {
            put_text(&out, ": the session needs ");
            put_number(&out, needed);
            put_text(&out, " bytes, BOARD_BYTES is ");
            put_number(&out, BOARD_BYTES);
        }
    }
    link_answer(&line, out.bytes, out.count);
}

/* Write an answer, after a zero that ends what the firmware may have printed on the line. */
static void write_answer(void)
{
    port_write(0u);
    for (size_t k = 0; k < line.answer_bytes; k++) {
        port_write(line.answer[k]);
    }
}

int main(void)
{
    int byte;
    line.message = message;
    line.capacity = sizeof message;
    port_init();
    while ((byte = port_read()) >= 0) {
        const int taken = link_take(&line, (unsigned char)byte);
        if (taken > 0) {
            link_busy(&line);
            write_answer();
            answer_message();
        }
        if (taken) {
            write_answer();
        }
    }
    return 0;
}

/* Scan logs: every number of a complete one, and every way to be cut or changed. */
#include "check.h"
#include "ek/scanlog.h"

#define HEADER 52u /* bytes */
#define SCAN 88u   /* bytes of a scan of two beams with odometry and motion */
#define BEAMS 2u

static unsigned char bytes[HEADER + SCAN];

static void put(size_t at, uint64_t bits, size_t count)
{
    for (size_t k = 0; k < count; k++) {
        bytes[at + k] = (unsigned char)(bits >> (8u * k) & 0xFFu);
    }
}

static void put_double(size_t at, double number)
{
    uint64_t bits;
    memcpy(&bits, &number, sizeof bits);
    put(at, bits, 8u);
}

static void put_float(size_t at, float number)
{
    uint32_t bits;
    memcpy(&bits, &number, sizeof bits);
    put(at, bits, 4u);
}

/* Numbers 1, 2, 3 ... that float and double hold exactly. */
static void fill(void)
{
    memcpy(bytes, "EKSL", 4u);
    put(4u, 1u, 4u);
    put(8u, BEAMS, 4u);
    for (size_t k = 0; k < 5u; k++) {
        put_double(12u + 8u * k, 1.0 + (double)k);
    }
    put(HEADER, (uint64_t)-7, 8u);
    put(HEADER + 8u, 200u, 8u);
    put(HEADER + 16u, BEAMS, 4u);
    put(HEADER + 20u, 3u, 4u);
    for (size_t k = 0; k < 6u; k++) {
        put_double(HEADER + 24u + 8u * k, 10.0 + (double)k);
    }
    for (size_t k = 0; k < 4u; k++) {
        put_float(HEADER + 72u + 4u * k, 20.0f + (float)k);
    }
}

/* What a file with the first `length` bytes gives: of the header, and of one scan. */
static ek_status first_of(size_t length, ek_scanlog *log, ek_sweep *sweep, ek_status *next)
{
    static ek_real ranges[BEAMS], angles[BEAMS];
    FILE *const file = tmpfile();
    if (!file) {
        exit(EXIT_FAILURE);
    }
    CHECK(fwrite(bytes, 1u, length, file) == length);
    rewind(file);
    const ek_status status = ek_scanlog_open(file, log);
    *next = status == EK_OK ? ek_scanlog_next(file, log, ranges, angles, sweep) : EK_STATUS_COUNT;
    CHECK(*next != EK_OK || ek_scanlog_next(file, log, ranges, angles, sweep) == EK_END_OF_FILE);
    fclose(file);
    return status;
}

static void every_number_is_read_and_no_cut_file_is_accepted(void)
{
    ek_scanlog log;
    ek_sweep sweep;
    ek_status next;
    fill();
    for (size_t length = 0u; length < HEADER; length++) {
        CHECK(first_of(length, &log, &sweep, &next) == EK_BAD_FILE);
    }
    for (size_t length = HEADER; length <= HEADER + SCAN; length++) {
        CHECK(first_of(length, &log, &sweep, &next) == EK_OK);
        CHECK(next == (length == HEADER ? EK_END_OF_FILE : length < HEADER + SCAN ? EK_BAD_FILE : EK_OK));
    }
    CHECK_NEAR(log.range_min, 1.0, 0.0);
    CHECK_NEAR(log.range_max, 2.0, 0.0);
    CHECK_NEAR(log.base_from_sensor.x, 3.0, 0.0);
    CHECK_NEAR(log.base_from_sensor.y, 4.0, 0.0);
    CHECK_NEAR(log.base_from_sensor.theta, 5.0, 0.0);
    CHECK(log.max_beams == BEAMS);
    fill();
    CHECK(first_of(HEADER + SCAN, &log, &sweep, &next) == EK_OK && next == EK_OK);
}

static void both_motions_of_a_scan_are_read(void)
{
    ek_real ranges[BEAMS], angles[BEAMS];
    ek_scanlog log;
    ek_sweep sweep;
    FILE *const file = tmpfile();
    fill();
    CHECK(file && fwrite(bytes, 1u, sizeof bytes, file) == sizeof bytes);
    if (!file) {
        return;
    }
    rewind(file);
    CHECK(ek_scanlog_open(file, &log) == EK_OK && ek_scanlog_next(file, &log, ranges, angles, &sweep) == EK_OK);
    CHECK(sweep.stamp_ns == -7 && sweep.time_increment_ns == 200 && sweep.beams == BEAMS);
    CHECK(sweep.has_odometry == 1 && sweep.has_motion == 1);
    const ek_real found[] = {sweep.odom_from_base.x, sweep.odom_from_base.y, sweep.odom_from_base.theta,
                             sweep.start_from_end.x, sweep.start_from_end.y, sweep.start_from_end.theta};
    for (size_t k = 0; k < 6u; k++) {
        CHECK_NEAR(found[k], 10.0 + (double)k, 0.0);
    }
    CHECK_NEAR(ranges[0], 20.0, 0.0);
    CHECK_NEAR(ranges[1], 21.0, 0.0);
    CHECK_NEAR(angles[0], 22.0, 0.0);
    CHECK_NEAR(angles[1], 23.0, 0.0);
    fclose(file);
}

static void changed_numbers_are_refused(void)
{
    static const struct {
        size_t at;
        uint32_t number;
        ek_status header, scan;
    } changes[] = {{4u, 2u, EK_BAD_FILE, EK_OK},                   /* version */
                   {8u, 0u, EK_BAD_FILE, EK_OK},                   /* no beams */
                   {8u, (1u << 20) + 1u, EK_BAD_FILE, EK_OK},      /* too many */
                   {8u, 1u << 20, EK_OK, EK_OK},
                   {HEADER + 16u, 3u, EK_OK, EK_BAD_FILE},         /* more beams than the header says */
                   {HEADER + 20u, 4u, EK_OK, EK_BAD_FILE}};        /* a flag that no version has */
    ek_scanlog log;
    ek_sweep sweep;
    ek_status next;
    for (size_t k = 0; k < sizeof changes / sizeof *changes; k++) {
        fill();
        put(changes[k].at, changes[k].number, 4u);
        CHECK(first_of(HEADER + SCAN, &log, &sweep, &next) == changes[k].header);
        CHECK(changes[k].header != EK_OK || next == changes[k].scan);
    }
    fill();
    bytes[3] = 'X';
    CHECK(first_of(HEADER + SCAN, &log, &sweep, &next) == EK_BAD_FILE);
}

static void a_file_that_cannot_be_read_is_bad_and_not_at_its_end(void)
{
    static const char *const name = "test_scanlog.tmp";
    ek_real ranges[BEAMS], angles[BEAMS];
    const ek_scanlog log = {BEAMS, EK_R(0.0), EK_R(1.0), {EK_R(0.0), EK_R(0.0), EK_R(0.0)}};
    ek_sweep sweep;
    FILE *const file = fopen(name, "wb"); /* for writing only */
    CHECK(file != NULL);
    if (file) {
        CHECK(ek_scanlog_next(file, &log, ranges, angles, &sweep) == EK_BAD_FILE);
        CHECK(ek_scanlog_next(NULL, &log, ranges, angles, &sweep) == EK_NULL_POINTER);
        CHECK(ek_scanlog_next(file, NULL, ranges, angles, &sweep) == EK_NULL_POINTER);
        CHECK(ek_scanlog_next(file, &log, NULL, angles, &sweep) == EK_NULL_POINTER);
        CHECK(ek_scanlog_next(file, &log, ranges, NULL, &sweep) == EK_NULL_POINTER);
        CHECK(ek_scanlog_next(file, &log, ranges, angles, NULL) == EK_NULL_POINTER);
        CHECK(ek_scanlog_open(file, NULL) == EK_NULL_POINTER && ek_scanlog_open(NULL, NULL) == EK_NULL_POINTER);
        fclose(file);
        remove(name);
    }
}

int main(void)
{
    every_number_is_read_and_no_cut_file_is_accepted();
    both_motions_of_a_scan_are_read();
    changed_numbers_are_refused();
    a_file_that_cannot_be_read_is_bad_and_not_at_its_end();
    return verdict();
}

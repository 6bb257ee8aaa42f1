#include "ek/scanlog.h"

#include <string.h>

#define VERSION 1u
#define HAS_ODOMETRY 1u
#define HAS_MOTION 2u
#define MAX_BEAMS ((uint32_t)1 << 20)

static int read_unsigned(FILE *file, int bytes, uint64_t *value)
{
    unsigned char raw[8];
    if (fread(raw, 1u, (size_t)bytes, file) != (size_t)bytes) {
        return 0;
    }
    *value = 0u;
    for (int k = bytes - 1; k >= 0; k--) {
        *value = *value << 8 | raw[k];
    }
    return 1;
}

static int read_u32(FILE *file, uint32_t *value)
{
    uint64_t bits;
    const int read = read_unsigned(file, 4, &bits);
    *value = read ? (uint32_t)bits : 0u;
    return read;
}

static int read_i64(FILE *file, int64_t *value)
{
    uint64_t bits;
    const int read = read_unsigned(file, 8, &bits);
    if (read) {
        memcpy(value, &bits, sizeof bits);
    }
    return read;
}

static int read_f64(FILE *file, ek_real *value)
{
    uint64_t bits;
    double number;
    if (!read_unsigned(file, 8, &bits)) {
        return 0;
    }
    memcpy(&number, &bits, sizeof number);
    *value = (ek_real)number;
    return 1;
}

static int read_pose(FILE *file, ek_pose *value)
{
    return read_f64(file, &value->x) && read_f64(file, &value->y) && read_f64(file, &value->theta);
}

static int read_f32_array(FILE *file, ek_real *values, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        uint32_t bits;
        float number;
        if (!read_u32(file, &bits)) {
            return 0;
        }
        memcpy(&number, &bits, sizeof number);
        values[i] = (ek_real)number;
    }
    return 1;
}

ek_status ek_scanlog_open(FILE *file, ek_scanlog *log)
{
    char magic[4];
    uint32_t version;
    if (!file || !log) {
        return EK_NULL_POINTER;
    }
    if (fread(magic, 1u, sizeof magic, file) != sizeof magic || memcmp(magic, "EKSL", sizeof magic) != 0 ||
        !read_u32(file, &version) || version != VERSION || !read_u32(file, &log->max_beams) || log->max_beams == 0u ||
        log->max_beams > MAX_BEAMS || !read_f64(file, &log->range_min) || !read_f64(file, &log->range_max) ||
        !read_pose(file, &log->base_from_sensor)) {
        return EK_BAD_FILE;
    }
    return EK_OK;
}

ek_status ek_scanlog_next(FILE *file, const ek_scanlog *log, ek_real *ranges, ek_real *angles, ek_sweep *sweep)
{
    uint32_t beams, flags;
    if (!file || !log || !ranges || !angles || !sweep) {
        return EK_NULL_POINTER;
    }
    const int next = fgetc(file);
    if (next == EOF) {
        return ferror(file) ? EK_BAD_FILE : EK_END_OF_FILE;
    }
    (void)ungetc(next, file); /* of one character it cannot fail */
    memset(sweep, 0, sizeof *sweep);
    if (!read_i64(file, &sweep->stamp_ns) || !read_i64(file, &sweep->time_increment_ns) || !read_u32(file, &beams) ||
        !read_u32(file, &flags) || beams > log->max_beams || (flags & ~(HAS_ODOMETRY | HAS_MOTION)) != 0u) {
        return EK_BAD_FILE;
    }
    sweep->has_odometry = (flags & HAS_ODOMETRY) != 0u;
    sweep->has_motion = (flags & HAS_MOTION) != 0u;
    if ((sweep->has_odometry && !read_pose(file, &sweep->odom_from_base)) ||
        (sweep->has_motion && !read_pose(file, &sweep->start_from_end)) || !read_f32_array(file, ranges, beams) ||
        !read_f32_array(file, angles, beams)) {
        return EK_BAD_FILE;
    }
    sweep->ranges = ranges;
    sweep->angles = angles;
    sweep->beams = beams;
    return EK_OK;
}

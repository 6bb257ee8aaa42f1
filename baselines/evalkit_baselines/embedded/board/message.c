#include <string.h>

#include "message.h"

uint64_t take_unsigned(reader *in, size_t bytes)
{
    uint64_t value = 0u;
    if (bytes > in->left) {
        in->short_by += bytes - in->left;
        in->left = 0u;
        return 0u;
    }
    for (size_t k = bytes; k-- > 0u;) {
        value = value << 8 | in->from[k];
    }
    in->from += bytes;
    in->left -= bytes;
    return value;
}

double take_double(reader *in)
{
    const uint64_t bits = take_unsigned(in, sizeof bits);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

int32_t take_count(reader *in)
{
    const double value = take_double(in);
    return value >= 0.0 && value <= 2147483647.0 ? (int32_t)value : -1;
}

ek_pose take_pose(reader *in)
{
    ek_pose pose;
    pose.x = (ek_real)take_double(in);
    pose.y = (ek_real)take_double(in);
    pose.theta = (ek_real)take_double(in);
    return pose;
}

void take_reals(reader *in, ek_real *values, size_t count)
{
    const size_t bytes = count * sizeof *values;
    if (bytes > in->left) {
        in->short_by += bytes - in->left;
        in->left = 0u;
        return;
    }
    memcpy(values, in->from, bytes);
    in->from += bytes;
    in->left -= bytes;
}

void put_unsigned(writer *out, uint64_t value, size_t bytes)
{
    for (size_t k = 0; k < bytes; k++) {
        out->bytes[out->count++] = (unsigned char)(value >> 8u * k);
    }
}

void put_double(writer *out, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    put_unsigned(out, bits, sizeof bits);
}

void put_pose(writer *out, ek_pose pose)
{
    put_double(out, (double)pose.x);
    put_double(out, (double)pose.y);
    put_double(out, (double)pose.theta);
}

void put_text(writer *out, const char *text)
{
    const size_t length = strlen(text), room = sizeof out->bytes - out->count;
    memcpy(out->bytes + out->count, text, length < room ? length : room);
    out->count += length < room ? length : room;
}

void put_number(writer *out, size_t number)
{
    char digits[24];
    size_t first = sizeof digits - 1u;
    digits[first] = 0;
    do {
        digits[--first] = (char)('0' + number % 10u);
        number /= 10u;
    } while (number > 0u);
    put_text(out, digits + first);
}

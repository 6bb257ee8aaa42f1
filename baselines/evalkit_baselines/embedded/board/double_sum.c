/* Correct sums and differences of doubles. libgcc's routines for Arm processors without double-precision hardware (seen
 * in gcc 12.2) round wrongly where the exponents differ by exactly 33 and the result is shifted left: of 1 - x with
 * 2^-33 <= x < 2^-32 every second one. Link with -Wl,--wrap=__aeabi_dadd,--wrap=__aeabi_dsub,--wrap=__aeabi_drsub. */
#include <stdint.h>
#include <string.h>

#define FRACTION 52
#define GUARD 10 /* bits below the last place, the lowest one for all that is lost */
#define WRONG 33

#define CORE_REGISTERS __attribute__((pcs("aapcs"))) /* also where floating-point registers pass arguments */
CORE_REGISTERS double __real___aeabi_dadd(double a, double b);
CORE_REGISTERS double __wrap___aeabi_dadd(double a, double b);
CORE_REGISTERS double __wrap___aeabi_dsub(double a, double b);
CORE_REGISTERS double __wrap___aeabi_drsub(double a, double b);

static uint64_t bits_of(double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static double from_bits(uint64_t bits)
{
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static uint64_t exponent_of(uint64_t bits)
{
    return bits >> FRACTION & 0x7ffu;
}

static uint64_t fraction_of(uint64_t bits)
{
    return (bits & (((uint64_t)1 << FRACTION) - 1u)) | (uint64_t)1 << FRACTION;
}

/* The larger number minus the smaller one: opposite signs, normal numbers, exponents WRONG apart. */
static double subtract(uint64_t larger, uint64_t smaller)
{
    const uint64_t small = fraction_of(smaller) << GUARD;
    const uint64_t shifted = small >> WRONG | ((small & (((uint64_t)1 << WRONG) - 1u)) != 0u);
    uint64_t exponent = exponent_of(larger), sum = (fraction_of(larger) << GUARD) - shifted;
    if (sum < (uint64_t)1 << (FRACTION + GUARD)) {
        sum <<= 1;
        exponent--;
    }
    const uint64_t rest = sum & ((1u << GUARD) - 1u), half = 1u << (GUARD - 1);
    sum >>= GUARD;
    sum += rest > half || (rest == half && (sum & 1u));
    /* a carry out of the fraction increments the exponent */
    return from_bits((larger & (uint64_t)1 << 63) | (((exponent - 1u) << FRACTION) + sum));
}

CORE_REGISTERS double __wrap___aeabi_dadd(double a, double b)
{
    const uint64_t first = bits_of(a), second = bits_of(b);
    const uint64_t one = exponent_of(first), other = exponent_of(second);
    if ((first ^ second) >> 63 && one && other && one < 0x7ffu && other < 0x7ffu) {
        if (one == other + WRONG) {
            return subtract(first, second);
        }
        if (other == one + WRONG) {
            return subtract(second, first);
        }
    }
    return __real___aeabi_dadd(a, b);
}

CORE_REGISTERS double __wrap___aeabi_dsub(double a, double b)
{
    return __wrap___aeabi_dadd(a, from_bits(bits_of(b) ^ (uint64_t)1 << 63));
}

CORE_REGISTERS double __wrap___aeabi_drsub(double a, double b)
{
    return __wrap___aeabi_dsub(b, a);
}

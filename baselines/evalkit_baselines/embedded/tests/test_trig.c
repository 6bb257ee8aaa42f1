/* Sine, cosine and arc tangent: near the C library's, and the same bits on every processor. */
#include "check.h"

#ifdef EK_FLOAT
#define BITS 0xe8bbbb41c64c7848u
#else
#define BITS 0xc3be7faddb645150u
#endif

/* Add the bits of a number to a checksum (FNV-1a). */
static uint64_t add_bits(uint64_t sum, ek_real number)
{
    unsigned char bytes[sizeof number];
    uint64_t raw = 0u;
    memcpy(bytes, &number, sizeof number);
    memcpy(&raw, bytes, sizeof bytes);
    for (unsigned k = 0; k < 8u * sizeof number; k += 8u) {
        sum = (sum ^ (raw >> k & 255u)) * 0x100000001b3u;
    }
    return sum;
}

static void test_values_and_bits(void)
{
    uint64_t random = 1u, sum = 0xcbf29ce484222325u;
    ek_real worst = EK_R(0.0);
    for (int i = 0; i < 100000; i++) {
        const ek_real angle = uniform(&random, -6.3, 6.3);
        const ek_real x = uniform(&random, -1.0, 1.0), y = uniform(&random, -1.0, 1.0);
        const ek_real found[3] = {EK_NAME(sin)(angle), EK_NAME(cos)(angle), EK_NAME(atan2)(y, x)};
        const double expected[3] = {sin((double)angle), cos((double)angle), atan2((double)y, (double)x)};
        for (int k = 0; k < 3; k++) {
            const ek_real off = (ek_real)fabs((double)found[k] - expected[k]);
            worst = off > worst ? off : worst;
            sum = add_bits(sum, found[k]);
        }
    }
    CHECK(worst <= EK_R(2.0) * EK_EPSILON);
    CHECK(sum == BITS);
}

static void test_special_arguments(void)
{
    CHECK(EK_NAME(sin)(EK_R(0.0)) == EK_R(0.0) && EK_NAME(cos)(EK_R(0.0)) == EK_R(1.0));
    CHECK(EK_NAME(atan2)(EK_R(0.0), EK_R(0.0)) == EK_R(0.0) && EK_NAME(atan2)(EK_R(0.0), EK_R(-2.0)) == EK_PI);
    CHECK(EK_NAME(atan2)(EK_R(-0.0), EK_R(-2.0)) == -EK_PI && EK_NAME(atan2)(EK_R(3.0), EK_R(0.0)) == EK_R(0.5) * EK_PI);
    CHECK(EK_NAME(sin)(-EK_R(1.25)) == -EK_NAME(sin)(EK_R(1.25)) && EK_NAME(cos)(-EK_R(1.25)) == EK_NAME(cos)(EK_R(1.25)));
    CHECK(isnan(EK_NAME(sin)((ek_real)INFINITY)) && isnan(EK_NAME(cos)((ek_real)NAN)) && isnan(EK_NAME(atan2)((ek_real)NAN, EK_R(1.0))));
    /* far from zero the angle itself is uncertain by half a unit of its last place */
    CHECK(EK_FABS(EK_NAME(sin)(EK_R(300000.0)) - (ek_real)sin(300000.0)) <= EK_R(150000.0) * EK_EPSILON);
}

int main(void)
{
    test_values_and_bits();
    test_special_arguments();
    return verdict();
}

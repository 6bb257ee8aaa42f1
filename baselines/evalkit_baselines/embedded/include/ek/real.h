/* real.h - number type of a build, and symbol names that let both builds link into one program.
 *
 * Compile with -DEK_FLOAT for single precision, without it for double. EK_NAME gives every symbol a prefix: ek32_ in a
 * float build, ek64_ in a double build; ek_... in the source is a macro.
 */
#ifndef EK_REAL_H
#define EK_REAL_H

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>

/* A lidar's beam without an echo is infinite or nan, and wrong input is refused where it is: neither works if the compiler may
 * assume that there are none. */
#if defined(__FAST_MATH__) || defined(__ASSOCIATIVE_MATH__) || defined(_M_FP_FAST) || \
    (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "evalkit needs infinite numbers, nan and sums in their order: compile without -ffast-math, -Ofast and /fp:fast"
#endif

#define EK_JOIN_(a, b) a##b
#define EK_JOIN(a, b) EK_JOIN_(a, b)

#ifdef EK_FLOAT
typedef float ek_real;
#define EK_NAME(name) EK_JOIN(ek32_, name)
#define EK_EPSILON FLT_EPSILON
#define EK_SQRT sqrtf
#define EK_FLOOR floorf
#define EK_FABS fabsf
#else
typedef double ek_real;
#define EK_NAME(name) EK_JOIN(ek64_, name)
#define EK_EPSILON DBL_EPSILON
#define EK_SQRT sqrt
#define EK_FLOOR floor
#define EK_FABS fabs
#endif

#define EK_R(number) ((ek_real)(number))
#define EK_PI EK_R(3.14159265358979323846)

#ifdef __cplusplus
extern "C" {
#endif

/* Sine and cosine of an angle (rad), and the angle of the direction (x, y), within 2 units of the last place for angles
 * up to 6 rad (trig.c). Where an angle is not finite: nan. */
ek_real EK_NAME(sin)(ek_real angle);
ek_real EK_NAME(cos)(ek_real angle);
ek_real EK_NAME(atan2)(ek_real y, ek_real x);

#ifdef __cplusplus
}
#endif

/* With -DEK_PORTABLE the core uses these, and gives the same bits with every C library; otherwise the C library's. */
#ifdef EK_PORTABLE
#define EK_SIN EK_NAME(sin)
#define EK_COS EK_NAME(cos)
#define EK_TAN(angle) (EK_SIN(angle) / EK_COS(angle))
#define EK_ATAN2 EK_NAME(atan2)
#elif defined(EK_FLOAT)
#define EK_SIN sinf
#define EK_COS cosf
#define EK_TAN tanf
#define EK_ATAN2 atan2f
#else
#define EK_SIN sin
#define EK_COS cos
#define EK_TAN tan
#define EK_ATAN2 atan2
#endif

/* Largest allowed coordinate (m). */
#define EK_MAX_COORDINATE EK_R(1e6)

/* Position of points that are left out (m): distances to it stay finite in both builds. */
#define EK_FAR EK_R(1e18)

#define ek_floor EK_NAME(floor)

/* The largest whole number that is not above a number below 2^31 in size. Loops with it become vectors without SSE 4.1, too. */
static inline int32_t ek_floor(ek_real number)
{
    const int32_t whole = (int32_t)number;
    return whole - (number < (ek_real)whole);
}

/* Hot loops process groups of this many lanes; arrays are padded to a multiple of it. */
#define EK_LANES 8u
#define EK_PADDED(count) (((size_t)(count) + (EK_LANES - 1u)) / EK_LANES * EK_LANES)

#if defined(__GNUC__) || defined(__clang__)
#define EK_RESTRICT __restrict__
#define EK_PREFETCH(address) __builtin_prefetch(address)
#else
#define EK_RESTRICT
#define EK_PREFETCH(address) ((void)(address))
#endif

#endif

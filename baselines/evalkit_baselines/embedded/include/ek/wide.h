/* wide.h - loops over lanes, compiled three times: for every processor, for those with AVX2, and for those with AVX-512.
 *
 * All give the same bits: the sums of a loop run in EK_LANES lanes (real.h), no operation is reordered, and none is fused.
 * AVX2 has no fused multiply-add; AVX-512 has, and needs -ffp-contract=off, which gcc sets with -std=c99. A loop is an
 * EK_LOOP function; EK_COPIES makes the two other copies of it, and EK_CALL calls the one for ek_wide(). Copies that no compiler
 * makes from the loop are written by hand (src/lanes.h). Where a copy for AVX2 gains nothing, the loop itself has its name
 * (#define loop_avx2 loop). On aarch64 the copy for every processor uses NEON, which all of them have.
 */
#ifndef EK_WIDE_H
#define EK_WIDE_H

/* What a processor has: a number above 0 includes the ones below it. */
#define EK_AVX2 1
#define EK_AVX512 2

#if defined(__GNUC__) && defined(__x86_64__) && !defined(EK_TALLY)
#define EK_COPIED 1
#define EK_LOOP static inline __attribute__((always_inline))
#define EK_WIDE __attribute__((target("avx2")))
#ifdef __clang__
#define EK_WIDEST __attribute__((target("avx512f,avx512bw,avx512cd,avx512dq,avx512vl,popcnt")))
#else
#define EK_WIDEST __attribute__((target("avx512f,avx512bw,avx512cd,avx512dq,avx512vl,popcnt,prefer-vector-width=512")))
#endif
#define EK_HAS(part) (__builtin_cpu_supports(part) ? 1 : 0)
#define EK_HAS_AVX512 /* all that EK_WIDEST names */ \
    (EK_HAS("avx512f") & EK_HAS("avx512bw") & EK_HAS("avx512cd") & EK_HAS("avx512dq") & EK_HAS("avx512vl") & EK_HAS("popcnt"))
#define ek_wide() (!EK_HAS("avx2") ? 0 : EK_HAS_AVX512 ? EK_AVX512 : EK_AVX2)
#define EK_IF_WIDE(wide) (wide) /* at least AVX2 */
#define EK_COPIES(returned, loop, parameters, body) \
    EK_WIDE static returned loop##_avx2 parameters body \
    EK_WIDEST static returned loop##_avx512 parameters body
#define EK_CALL(wide, loop, arguments) \
    ((wide) == EK_AVX512 ? loop##_avx512 arguments : (wide) == EK_AVX2 ? loop##_avx2 arguments : loop arguments)
#else /* no other copy on a board, nor where its work is counted */
#define EK_COPIED 0
#define EK_LOOP static inline
#define EK_WIDE
#define EK_WIDEST
#define ek_wide() 0
#define EK_COPIES(returned, loop, parameters, body)
#define EK_CALL(wide, loop, arguments) ((void)(wide), loop arguments)
#define EK_IF_WIDE(wide) (0 && (wide))
#endif

/* Loops over lanes that a compiler would unroll before it makes vectors of them. */
#if defined(__GNUC__) && !defined(__clang__)
#define EK_LANE_BY_LANE _Pragma("GCC unroll 1")
#else
#define EK_LANE_BY_LANE
#endif

/* 1: places are searched in groups (nearby.h). Not on a processor without vectors, nor where its work is counted. */
#if (defined(__x86_64__) || defined(_M_X64) || defined(__aarch64__) || defined(_M_ARM64)) && !defined(EK_TALLY)
#define EK_GROUPED 1
#else
#define EK_GROUPED 0
#endif

#endif

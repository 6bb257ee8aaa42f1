/* wide.h - loops over lanes, compiled twice: for every processor, and for those with AVX2.
 *
 * Both give the same bits: the sums of a loop run in EK_LANES lanes (real.h), no operation is reordered, and AVX2 has no
 * fused multiply-add. A loop is an EK_LOOP function; EK_WIDE marks the copy that is called where EK_IF_WIDE(ek_is_wide())
 * is 1. On aarch64 the copy for every processor uses NEON, which all of them have.
 */
#ifndef EK_WIDE_H
#define EK_WIDE_H

#if defined(__GNUC__) && defined(__x86_64__) && !defined(EK_TALLY)
#define EK_LOOP static inline __attribute__((always_inline))
#define EK_WIDE __attribute__((target("avx2")))
#define EK_IF_WIDE(wide) (wide)
#define ek_is_wide() (__builtin_cpu_supports("avx2") ? 1 : 0)
#else
#define EK_LOOP static inline
#define EK_WIDE
#define EK_IF_WIDE(wide) (0 && (wide)) /* no second copy on a board, nor where its work is counted */
#define ek_is_wide() 0
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

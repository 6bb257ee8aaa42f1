/* lanes.h - private: eight numbers at once with AVX-512, for loops that no compiler makes vectors of. */
#ifndef EK_LANES_H
#define EK_LANES_H

#include "ek/real.h"
#include "ek/wide.h"

#if EK_COPIED
#include <immintrin.h>

/* Eight numbers of the build, what is done with them, and which of them are below or equal to others, or where one is no number. */
#ifdef EK_FLOAT
typedef __m256 ek_lanes;
#define EK_LANES_OF(operation) _mm256_##operation##_ps
#define EK_BELOW(one, other) _mm256_cmp_ps_mask(one, other, _CMP_LT_OQ)
#define EK_EQUAL(one, other) _mm256_cmp_ps_mask(one, other, _CMP_EQ_OQ)
#define EK_NAN(one, other) _mm256_cmp_ps_mask(one, other, _CMP_UNORD_Q)
#else
typedef __m512d ek_lanes;
#define EK_LANES_OF(operation) _mm512_##operation##_pd
#define EK_BELOW(one, other) _mm512_cmp_pd_mask(one, other, _CMP_LT_OQ)
#define EK_EQUAL(one, other) _mm512_cmp_pd_mask(one, other, _CMP_EQ_OQ)
#define EK_NAN(one, other) _mm512_cmp_pd_mask(one, other, _CMP_UNORD_Q)
#endif

/* The smallest of eight numbers. */
EK_WIDEST static inline ek_real ek_least_lane(ek_lanes numbers)
{
#ifdef EK_FLOAT
    const __m128 four = _mm_min_ps(_mm256_castps256_ps128(numbers), _mm256_extractf128_ps(numbers, 1));
    const __m128 two = _mm_min_ps(four, _mm_movehl_ps(four, four));
    return _mm_cvtss_f32(_mm_min_ss(two, _mm_movehdup_ps(two)));
#else
    return _mm512_reduce_min_pd(numbers);
#endif
}

/* The numbers from `first` to first + 7. */
EK_WIDEST static inline __m256i ek_count_lanes(uint32_t first)
{
    return _mm256_add_epi32(_mm256_set1_epi32((int32_t)first), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
}

EK_WIDEST static inline void ek_store_numbers(uint32_t *to, __m256i numbers)
{
    _mm256_storeu_si256((__m256i *)(void *)to, numbers);
}

/* x and y of eight points; those after the first `count` are 0, and are not read. */
EK_WIDEST static inline void ek_split_pairs(const ek_real *xy, uint32_t count, ek_lanes *x, ek_lanes *y)
{
    const uint32_t both = (1u << (2u * count)) - 1u;
#ifdef EK_FLOAT
    const __m512 all = _mm512_maskz_loadu_ps((__mmask16)both, xy);
    const __m256 low = _mm512_castps512_ps256(all), high = _mm512_extractf32x8_ps(all, 1);
    *x = _mm256_permutex2var_ps(low, _mm256_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14), high);
    *y = _mm256_permutex2var_ps(low, _mm256_setr_epi32(1, 3, 5, 7, 9, 11, 13, 15), high);
#else
    const __m512d low = _mm512_maskz_loadu_pd((__mmask8)both, xy);
    const __m512d high = _mm512_maskz_loadu_pd((__mmask8)(both >> 8), xy + 8);
    *x = _mm512_permutex2var_pd(low, _mm512_setr_epi64(0, 2, 4, 6, 8, 10, 12, 14), high);
    *y = _mm512_permutex2var_pd(low, _mm512_setr_epi64(1, 3, 5, 7, 9, 11, 13, 15), high);
#endif
}

/* Eight numbers in single precision. */
EK_WIDEST static inline __m256 ek_single_lanes(ek_lanes numbers)
{
#ifdef EK_FLOAT
    return numbers;
#else
    return _mm512_cvtpd_ps(numbers);
#endif
}

/* Eight numbers as whole numbers, towards zero. */
EK_WIDEST static inline __m256i ek_whole_lanes(ek_lanes numbers)
{
#ifdef EK_FLOAT
    return _mm256_cvttps_epi32(numbers);
#else
    return _mm512_cvttpd_epi32(numbers);
#endif
}

/* Squared distances of eight points from (x, y); only the first `count` are read. */
EK_WIDEST static inline ek_lanes ek_square_pairs(const ek_real *xy, uint32_t count, ek_real x, ek_real y)
{
    ek_lanes xs, ys;
    ek_split_pairs(xy, count, &xs, &ys);
    xs = EK_LANES_OF(sub)(xs, EK_LANES_OF(set1)(x));
    ys = EK_LANES_OF(sub)(ys, EK_LANES_OF(set1)(y));
    return EK_LANES_OF(add)(EK_LANES_OF(mul)(xs, xs), EK_LANES_OF(mul)(ys, ys));
}

/* Append to a list of `count` numbers those from `first` to first + 7 whose bit in `which` is set; returns their number. There
 * is room for eight. */
EK_WIDEST static inline uint32_t ek_append_lanes(uint32_t *list, uint32_t count, uint32_t first, __mmask8 which)
{
    ek_store_numbers(list + count, _mm256_maskz_compress_epi32(which, ek_count_lanes(first)));
    return count + (uint32_t)__builtin_popcount(which);
}

#endif
#endif

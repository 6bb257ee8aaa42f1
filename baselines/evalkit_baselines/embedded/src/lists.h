/* lists.h - private: list the lanes that meet a condition, with AVX-512, for loops that no compiler makes vectors of. */
#ifndef EK_LISTS_H
#define EK_LISTS_H

#include "ek/real.h"
#include "ek/wide.h"

#if EK_COPIED
#include <immintrin.h>

/* Append to a list of `count` numbers those from `first` to first + 7 whose bit in `which` is set; returns their number. Eight
 * are written, the last of them at most at first + 7: a list may be as long as the arrays it is made of. */
EK_WIDEST static inline uint32_t ek_append_lanes(uint32_t *list, uint32_t count, uint32_t first, __mmask8 which)
{
    const __m256i numbers = _mm256_add_epi32(_mm256_set1_epi32((int32_t)first), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
    _mm256_storeu_si256((__m256i *)(void *)(list + count), _mm256_maskz_compress_epi32(which, numbers));
    return count + (uint32_t)__builtin_popcount(which);
}

/* Eight numbers of 32 bits. */
EK_WIDEST static inline __m256i ek_load_lanes(const uint32_t *numbers)
{
    return _mm256_loadu_si256((const __m256i *)(const void *)numbers);
}

/* Which of eight numbers are above 0. */
EK_WIDEST static inline __mmask8 ek_lanes_above_zero(const ek_real *numbers)
{
#ifdef EK_FLOAT
    return _mm256_cmp_ps_mask(_mm256_loadu_ps(numbers), _mm256_setzero_ps(), _CMP_GT_OQ);
#else
    return _mm512_cmp_pd_mask(_mm512_loadu_pd(numbers), _mm512_setzero_pd(), _CMP_GT_OQ);
#endif
}

#endif
#endif

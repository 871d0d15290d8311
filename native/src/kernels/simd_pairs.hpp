// Products of 8-bit network weights and the integers inputs are rounded to: the one operation that vector extensions
// have no word for. Included by kernel_unit.cpp only (see simd.hpp).
#pragma once

#include "kernels/simd.hpp"

#if defined(__SSE2__)
#include <immintrin.h>
#endif

namespace physkin::PHYSKIN_ISA {

// Without overflow unless an input was not finite; what comes of those is thrown away.
inline Ints wrapping_sum(Ints a, Ints b) {
  typedef std::uint32_t Words __attribute__((vector_size(4 * kLanes)));
  return (Ints)((Words)a + (Words)b);
}

// 2 * kLanes network weights as the products below take them.
#if defined(__AVX512BW__)
typedef __m512i WidePairs;
inline WidePairs widen_pairs(const unsigned char* weights) {
  return _mm512_cvtepi8_epi16(*reinterpret_cast<const __m256i*>(weights));
}
#elif defined(__AVX2__)
typedef __m256i WidePairs;
inline WidePairs widen_pairs(const unsigned char* weights) {
  return _mm256_cvtepi8_epi16(*reinterpret_cast<const __m128i*>(weights));
}
#elif defined(__SSE2__)
typedef __m128i WidePairs;
inline WidePairs widen_pairs(const unsigned char* weights) {
  const __m128i bytes = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(weights));
  return _mm_srai_epi16(_mm_unpacklo_epi8(bytes, bytes), 8);
}
#else
typedef Ints WidePairs;
inline WidePairs widen_pairs(const unsigned char* weights) {
  typedef std::int16_t Shorts __attribute__((vector_size(2 * kLanes), may_alias));
  return __builtin_convertvector(*reinterpret_cast<const Shorts*>(weights), Ints);
}
#endif

// sum[k] + weights[2 k] * (low half of pair[k]) + weights[2 k + 1] * (high half of pair[k]), as 32-bit integers.
inline Ints add_pair_products(Ints sum, WidePairs weights, Ints pair) {
#if defined(__AVX512BW__)
  return wrapping_sum(sum, (Ints)_mm512_madd_epi16(weights, (__m512i)pair));
#elif defined(__AVX2__)
  return wrapping_sum(sum, (Ints)_mm256_madd_epi16(weights, (__m256i)pair));
#elif defined(__SSE2__)
  return wrapping_sum(sum, (Ints)_mm_madd_epi16(weights, (__m128i)pair));
#else
  const Ints low = ((weights << 24) >> 24) * ((pair << 16) >> 16), high = (weights >> 8) * (pair >> 16);
  return wrapping_sum(sum, wrapping_sum(low, high));
#endif
}

#if defined(__AVX512VNNI__)
// sum[k] + the products of four network weights, unsigned bytes, and the four signed bytes of quad[k]; modulo 2^32.
inline Ints add_quad_products(Ints sum, Ints weights, Ints quad) {
  return (Ints)_mm512_dpbusd_epi32((__m512i)sum, (__m512i)weights, (__m512i)quad);
}
#endif

}  // namespace physkin::PHYSKIN_ISA

// Registers as fours of lanes, a row of floats in each. Included by kernel_unit.cpp only (see simd.hpp).
#pragma once

#include "kernels/simd.hpp"

namespace physkin::PHYSKIN_ISA {

// In every four lanes the same choice of four from a, counted from 0, and b, counted from kLanes.
template <int k0, int k1, int k2, int k3>
inline Floats shuffle_fours(Floats a, Floats b) {
#if defined(__AVX512F__)
  return __builtin_shufflevector(a, b, k0, k1, k2, k3, k0 + 4, k1 + 4, k2 + 4, k3 + 4, k0 + 8, k1 + 8, k2 + 8, k3 + 8,
                                 k0 + 12, k1 + 12, k2 + 12, k3 + 12);
#elif defined(__AVX2__)
  return __builtin_shufflevector(a, b, k0, k1, k2, k3, k0 + 4, k1 + 4, k2 + 4, k3 + 4);
#else
  return __builtin_shufflevector(a, b, k0, k1, k2, k3);
#endif
}

// Of one register.
template <int k0, int k1, int k2, int k3>
inline Floats turned_fours(Floats v) {
#if defined(__aarch64__)  // GCC 12 takes two registers for the one, and moves it there
  constexpr uint32x4_t kBytes = {0x03020100 + 0x04040404u * k0, 0x03020100 + 0x04040404u * k1,
                                 0x03020100 + 0x04040404u * k2, 0x03020100 + 0x04040404u * k3};
  return (Floats)vqtbl1q_u8((uint8x16_t)v, (uint8x16_t)kBytes);
#else
  return shuffle_fours<k0, k1, k2, k3>(v, v);
#endif
}

inline Floats zip_low(Floats a, Floats b) { return shuffle_fours<0, kLanes, 1, kLanes + 1>(a, b); }
inline Floats zip_high(Floats a, Floats b) { return shuffle_fours<2, kLanes + 2, 3, kLanes + 3>(a, b); }
inline Floats halves_low(Floats a, Floats b) { return shuffle_fours<0, 1, kLanes, kLanes + 1>(a, b); }
inline Floats halves_high(Floats a, Floats b) { return shuffle_fours<2, 3, kLanes + 2, kLanes + 3>(a, b); }

typedef float Quad __attribute__((vector_size(16), may_alias));

template <int kFour>
inline Quad four_lanes(Floats v) {
#if defined(__AVX2__)
  return __builtin_shufflevector(v, v, 4 * kFour, 4 * kFour + 1, 4 * kFour + 2, 4 * kFour + 3);
#else
  static_assert(kFour == 0, "the register has four lanes");
  return v;
#endif
}

// The first four numbers of rows, a lane each: the first of all in columns[0], and so on. at(lane): where its row is.
template <class At>
inline void load_columns(At at, Floats* columns) {
  Floats row[4];
  for (int k = 0; k < 4; ++k) {
    const auto quad = [&](int lane) {
      Quad four;
      __builtin_memcpy(&four, at(lane), sizeof four);
      return four;
    };
#if defined(__AVX512F__)
    const __m512 first = _mm512_castps128_ps512((__m128)quad(k));
    const __m512 second = _mm512_maskz_insertf32x4(0xffff, first, (__m128)quad(k + 4), 1);
    const __m512 third = _mm512_maskz_insertf32x4(0xffff, second, (__m128)quad(k + 8), 2);
    row[k] = (Floats)_mm512_maskz_insertf32x4(0xffff, third, (__m128)quad(k + 12), 3);
#elif defined(__AVX2__)
    row[k] = (Floats)_mm256_insertf128_ps(_mm256_castps128_ps256((__m128)quad(k)), (__m128)quad(k + 4), 1);
#else
    row[k] = quad(k);
#endif
  }
  const Floats low = zip_low(row[0], row[1]), high = zip_high(row[0], row[1]);
  const Floats next_low = zip_low(row[2], row[3]), next_high = zip_high(row[2], row[3]);
  columns[0] = halves_low(low, next_low);
  columns[1] = halves_high(low, next_low);
  columns[2] = halves_low(high, next_high);
  columns[3] = halves_high(high, next_high);
}

// All lanes taken together by `both`, which has no order.
template <class Both>
inline float reduced(Floats v, Both both) {
  Quad four = four_lanes<0>(v);
#if defined(__AVX2__)
  four = both(four, four_lanes<1>(v));
#endif
#if defined(__AVX512F__)
  four = both(four, both(four_lanes<2>(v), four_lanes<3>(v)));
#endif
  four = both(four, __builtin_shufflevector(four, four, 2, 3, 0, 1));
  return both(four, __builtin_shufflevector(four, four, 1, 0, 3, 2))[0];
}

}  // namespace physkin::PHYSKIN_ISA

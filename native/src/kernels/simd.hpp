// Float vectors as wide as the registers of the instruction set this unit is compiled for.
//
// Included by kernel_unit.cpp only. Everything lives in a namespace named after the instruction set and nothing comes
// from the standard library's templates: the linker keeps one copy of an inline function, and a copy compiled for
// AVX-512 would crash an older CPU.
#pragma once

#include <cstdint>

#if defined(__aarch64__)
#include <arm_neon.h>
#elif defined(__x86_64__)
#include <immintrin.h>
#endif

namespace physkin::PHYSKIN_ISA {

#if defined(__AVX512F__)
constexpr int kLanes = 16;
#elif defined(__AVX2__)
constexpr int kLanes = 8;
#else
constexpr int kLanes = 4;
#endif

typedef float Floats __attribute__((vector_size(4 * kLanes), may_alias));
typedef float UnalignedFloats __attribute__((vector_size(4 * kLanes), may_alias, aligned(4)));
typedef std::int32_t Ints __attribute__((vector_size(4 * kLanes)));

typedef std::int32_t StoredInts __attribute__((vector_size(4 * kLanes), may_alias));

inline Ints load_ints(const void* p) { return (Ints)*reinterpret_cast<const StoredInts*>(p); }
inline Floats load(const float* p) { return *reinterpret_cast<const Floats*>(p); }
inline Floats load_unaligned(const float* p) { return *reinterpret_cast<const UnalignedFloats*>(p); }
inline void store(float* p, Floats v) { *reinterpret_cast<Floats*>(p) = v; }

// kLanes numbers as floats. GCC 12 converts narrow ones in steps, or one by one, where it is not told how.
inline Floats widened(const float* numbers) { return load(numbers); }

inline Floats widened(const std::int16_t* integers) {
#if defined(__aarch64__)
  return (Floats)vcvtq_f32_s32(vmovl_s16(vld1_s16(integers)));
#else
#if defined(__AVX512F__)
  const __m256i from = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(integers));
  const Ints words = (Ints)_mm512_maskz_cvtepi16_epi32(0xffff, from);
#elif defined(__AVX2__)
  const Ints words = (Ints)_mm256_cvtepi16_epi32(_mm_loadu_si128(reinterpret_cast<const __m128i*>(integers)));
#else
  typedef std::int16_t Shorts __attribute__((vector_size(2 * kLanes), may_alias));
  const Ints words = __builtin_convertvector(*reinterpret_cast<const Shorts*>(integers), Ints);
#endif
  return __builtin_convertvector(words, Floats);
#endif
}

inline Floats widened(const std::uint8_t* bytes) {
#if defined(__aarch64__)
  std::uint32_t four;
  __builtin_memcpy(&four, bytes, sizeof four);
  return (Floats)vcvtq_f32_u32(vmovl_u16(vget_low_u16(vmovl_u8(vcreate_u8(four)))));
#else
#if defined(__AVX512F__)
  const __m128i from = _mm_loadu_si128(reinterpret_cast<const __m128i*>(bytes));
  const Ints words = (Ints)_mm512_maskz_cvtepu8_epi32(0xffff, from);
#elif defined(__AVX2__)
  const Ints words = (Ints)_mm256_cvtepu8_epi32(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(bytes)));
#else
  typedef std::uint8_t Bytes __attribute__((vector_size(kLanes), may_alias));
  const Ints words = __builtin_convertvector(*reinterpret_cast<const Bytes*>(bytes), Ints);
#endif
  return __builtin_convertvector(words, Floats);
#endif
}

// Both keep a NaN in v: a non-finite value must reach the output check, not turn into a limit. So do minimum and maximum
// of SSE and AVX, whose second operand is the result where one is NaN; of a comparison GCC makes four times the work.
#if defined(__AVX2__) && !defined(__AVX512F__)
inline Floats at_least(Floats v, float limit) { return (Floats)_mm256_max_ps(_mm256_set1_ps(limit), (__m256)v); }
inline Floats at_most(Floats v, float limit) { return (Floats)_mm256_min_ps(_mm256_set1_ps(limit), (__m256)v); }
#elif defined(__x86_64__) && !defined(__AVX512F__)
inline Floats at_least(Floats v, float limit) { return (Floats)_mm_max_ps(_mm_set1_ps(limit), (__m128)v); }
inline Floats at_most(Floats v, float limit) { return (Floats)_mm_min_ps(_mm_set1_ps(limit), (__m128)v); }
#else
inline Floats at_least(Floats v, float limit) { return v < limit ? Floats{} + limit : v; }
inline Floats at_most(Floats v, float limit) { return v > limit ? Floats{} + limit : v; }
#endif

// Whether a comparison holds anywhere.
inline bool any(Ints holds) {
#if defined(__AVX512F__)
  return _mm512_test_epi32_mask((__m512i)holds, (__m512i)holds) != 0;
#elif defined(__AVX2__)
  return _mm256_movemask_ps((__m256)holds) != 0;
#elif defined(__x86_64__)
  return _mm_movemask_ps((__m128)holds) != 0;
#elif defined(__aarch64__)
  return vmaxvq_u32((uint32x4_t)holds) != 0;
#else
  return (holds[0] | holds[1] | holds[2] | holds[3]) != 0;
#endif
}

// A bit for each lane where a comparison holds, the first lane's the lowest.
inline unsigned bits_of(Ints holds) {
#if defined(__AVX512F__)
  return _mm512_test_epi32_mask((__m512i)holds, (__m512i)holds);
#elif defined(__AVX2__)
  return unsigned(_mm256_movemask_ps((__m256)holds));
#elif defined(__x86_64__)
  return unsigned(_mm_movemask_ps((__m128)holds));
#else
  return unsigned((holds[0] & 1) | (holds[1] & 2) | (holds[2] & 4) | (holds[3] & 8));
#endif
}

// exp(v), relative error below 2e-7; v is clamped to [-87, 88], where the result is a normal float.
inline Floats exponential(Floats v) {
  v = at_most(at_least(v, -87.0f), 88.0f);
  // v = k ln 2 + r with integer k. Adding 1.5 * 2^23 rounds to an integer and leaves it in the low bits.
  constexpr float kRound = 12582912.0f;
  const Floats shifted = v * 1.44269504f + kRound;
  const Floats k = shifted - kRound;
  const Floats r = v - k * 0.693359375f + k * 2.12194440e-4f;  // ln 2 in two parts, the first exact in products
  // Minimax polynomial of (exp(r) - 1 - r) / r^2 on |r| <= ln 2 / 2 (Cephes expf).
  Floats p = r * 1.9875691500e-4f + 1.3981999507e-3f;
  p = p * r + 8.3334519073e-3f;
  p = p * r + 4.1665795894e-2f;
  p = p * r + 1.6666665459e-1f;
  p = p * r + 5.0000001201e-1f;
  p = p * r * r + r + 1.0f;
  const Ints exponent = ((Ints)shifted - (Ints)(Floats{} + kRound)) << 23;
  return (Floats)((Ints)p + exponent);
}

// 1 / sqrt(v) for normal v > 0, relative error below 8e-7: a first guess, then Newton steps: one from the processor's
// guess (to 4e-4), two from the bits, the first with constants that balance that guess's error (to 7e-4).
inline Floats reciprocal_sqrt(Floats v) {
#if defined(__AVX512F__)
  Floats y = (Floats)_mm512_maskz_rsqrt14_ps(0xffff, (__m512)v);
#elif defined(__AVX2__)
  Floats y = (Floats)_mm256_rsqrt_ps((__m256)v);
#elif defined(__x86_64__)
  Floats y = (Floats)_mm_rsqrt_ps((__m128)v);
#else
  Floats y = (Floats)(0x5f1ffff9 - ((Ints)v >> 1));
  y = y * (1.68191391f - 0.703952009f * v * y * y);
#endif
  return y * (1.5f - 0.5f * v * y * y);
}

// What is to be multiplied with a normal of this squared length. Where networks put cloth light years away, the square
// overflows; the normal is then not of length one, but finite.
inline Floats inverse_length(Floats square) { return reciprocal_sqrt(at_most(square, 3e38f)); }

}  // namespace physkin::PHYSKIN_ISA

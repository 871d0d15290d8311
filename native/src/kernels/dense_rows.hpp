// Rows of network weights by precision: what a row is multiplied with, its bytes, and the sums it adds to. Included by
// kernel_unit.cpp only (see simd.hpp).
#pragma once

#include "kernels/fours.hpp"
#include "kernels/kernels.hpp"
#include "kernels/simd.hpp"

#if defined(__SSE2__)
#include <immintrin.h>
#elif defined(__wasm_simd128__)
#include <wasm_simd128.h>
#endif

namespace physkin::PHYSKIN_ISA {

struct Fp32Rows {
  typedef Floats Sum;
  static constexpr int kRegistersASum = 1;
  static constexpr int kInputs = 1;  // inputs a row
  static constexpr int bytes(int outputs) { return 4 * outputs; }

  const float* input;

  void prepare(const PackedLayer&, const DenseCall& call) { input = call.input; }

  typedef Floats Weights;
  static constexpr int kSumsALoad = 1;
  static Weights decode(const unsigned char* weights) { return load(reinterpret_cast<const float*>(weights)); }
  float factor(int row) const { return input[row]; }
  // sum and, where a load holds network weights of two sums, the one `other` further.
  static void multiply_add(Weights weights, float x, Sum* sum, int) { *sum += weights * x; }

  Floats value(Sum sum, const PackedLayer& layer, int at) const { return sum + load(layer.bias + at); }
};

struct Bf16Rows : Fp32Rows {
  static constexpr int bytes(int outputs) { return 2 * outputs; }

  typedef Ints Weights;
  static constexpr int kSumsALoad = 2;
  static Weights decode(const unsigned char* weights) { return load_ints(weights); }
  static void multiply_add(Weights words, float x, Sum* sum, int other) {
    sum[0] += (Floats)(words << 16) * x;
    sum[other] += (Floats)words * x;
  }
};

// --- Products of 8-bit network weights and the integers that inputs are rounded to: vector extensions have no word ---

// Without overflow unless an input was not finite; what comes of those is thrown away.
inline Ints wrapping_sum(Ints a, Ints b) {
  typedef std::uint32_t Words __attribute__((vector_size(4 * kLanes)));
  return (Ints)((Words)a + (Words)b);
}

#if defined(__AVX2__)

// sum[k] + weights[2 k] * (low half of pair[k]) + weights[2 k + 1] * (high half of pair[k]), as 32-bit integers.
inline Ints add_pair_products(Ints sum, Ints weights, Ints pair) {
#if defined(__AVX512BW__)
  return wrapping_sum(sum, (Ints)_mm512_madd_epi16((__m512i)weights, (__m512i)pair));
#else
  return wrapping_sum(sum, (Ints)_mm256_madd_epi16((__m256i)weights, (__m256i)pair));
#endif
}

#if defined(__AVX512VNNI__) || defined(__AVXVNNI__)
// sum[k] + the products of four network weights, unsigned bytes, and the four signed bytes of quad[k]; modulo 2^32.
inline Ints add_quad_products(Ints sum, Ints weights, Ints quad) {
#if defined(__AVX512VNNI__)
  return (Ints)_mm512_dpbusd_epi32((__m512i)sum, (__m512i)weights, (__m512i)quad);
#else
  return (Ints)_mm256_dpbusd_avx_epi32((__m256i)sum, (__m256i)weights, (__m256i)quad);
#endif
}
#endif

#else

// 2 * kLanes network weights as the products below take them.
#if defined(__SSE2__)
typedef __m128i WidePairs;
inline WidePairs widen_pairs(const unsigned char* weights) {
  const __m128i bytes = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(weights));
  return _mm_srai_epi16(_mm_unpacklo_epi8(bytes, bytes), 8);
}
#elif defined(__wasm_simd128__)
typedef v128_t WidePairs;
inline WidePairs widen_pairs(const unsigned char* weights) { return wasm_i16x8_load8x8(weights); }
#else
typedef Ints WidePairs;
inline WidePairs widen_pairs(const unsigned char* weights) {
  typedef std::int16_t Shorts __attribute__((vector_size(2 * kLanes), may_alias));
  return __builtin_convertvector(*reinterpret_cast<const Shorts*>(weights), Ints);
}
#endif

// sum[k] + weights[2 k] * (low half of pair[k]) + weights[2 k + 1] * (high half of pair[k]), as 32-bit integers.
inline Ints add_pair_products(Ints sum, WidePairs weights, Ints pair) {
#if defined(__SSE2__)
  return wrapping_sum(sum, (Ints)_mm_madd_epi16(weights, (__m128i)pair));
#elif defined(__wasm_simd128__)
  return wrapping_sum(sum, (Ints)wasm_i32x4_dot_i16x8(weights, (v128_t)pair));
#else
  const Ints low = ((weights << 24) >> 24) * ((pair << 16) >> 16), high = (weights >> 8) * (pair >> 16);
  return wrapping_sum(sum, wrapping_sum(low, high));
#endif
}

#endif

// What the ways to multiply 8-bit network weights share: inputs as integers.
struct QuantisedInputs {
  float unit;  // input of 1 in integers; NaN if an input is not finite, as the layer's outputs must be then

  // Calls store(i, integers) for inputs i to i + kLanes, zeros beyond the last.
  template <class Store>
  void quantise(const PackedLayer& layer, const float* input, Store store) {
    // Magnitudes have the order of their bits, above all of them infinity and then NaN.
    Ints largest = (Ints)(Floats{} + 1e-30f);
    for_each_vector(input, layer.inputs, [&](int, Floats v) {
      const Ints magnitude = (Ints)v & 0x7fffffff;
      largest = magnitude > largest ? magnitude : largest;
    });
    const float most = largest_lane(largest);
    unit = most / layer.input_limit + most * 0.0f;
    const float scale = layer.input_limit / most;
    constexpr float kRound = 12582912.0f;  // 1.5 * 2^23: adding it rounds to an integer in the low bits
    for_each_vector(input, layer.inputs,
                    [&](int i, Floats v) { store(i, (Ints)(v * scale + kRound) - (Ints)(Floats{} + kRound)); });
  }

  // Calls f(i, inputs i to i + kLanes), zeros beyond the last.
  template <class F>
  static void for_each_vector(const float* input, int count, F f) {
    int i = 0;
    for (; i + kLanes <= count; i += kLanes) f(i, load(input + i));
    if (i == count) return;
    Ints lane;
    for (int k = 0; k < kLanes; ++k) lane[k] = k;
    f(i, lane + i < count ? load(input + i) : Floats{});
  }

  // Of floats that are not negative, by their bits.
  static float largest_lane(Ints v) {
    std::int32_t lane[kLanes];
    __builtin_memcpy(lane, &v, sizeof lane);
    for (int half = kLanes / 2; half > 0; half /= 2) {
      for (int k = 0; k < half; ++k) lane[k] = lane[k] > lane[k + half] ? lane[k] : lane[k + half];
    }
    float largest;
    __builtin_memcpy(&largest, lane, sizeof largest);
    return largest;
  }

  Floats value(Ints sum, const PackedLayer& layer, int at) const {
    return __builtin_convertvector(sum, Floats) * (load(layer.output_scale + at) * unit) + load(layer.bias + at);
  }
};

// The 32 bits at `data`.
inline std::int32_t word_at(const void* data) {
  std::int32_t word;
  __builtin_memcpy(&word, data, sizeof word);
  return word;
}

#if defined(__AVX2__)

// Rows of four inputs. Network weights are stored as w + 128, unsigned bytes: the sum over (w + 128) q is that over w q
// plus 128 times that over q. Exact: all is integer and modulo 2^32, and the sum over w q is within 32 bits.
struct QuadInputs : QuantisedInputs {
  static constexpr Int8Layout kLayout{4, 128};
  static constexpr int kInputs = 4;
  static constexpr int kSumsALoad = 1;
  static constexpr int bytes(int outputs) { return kInputs * outputs; }

  std::int32_t surplus;  // 128 times the sum of all integers

  template <class Store>
  void quantise(const PackedLayer& layer, const float* input, Store store) {
    Ints sum = {};
    QuantisedInputs::quantise(layer, input, [&](int i, Ints rounded) {
      store(i, rounded);
      sum = wrapping_sum(sum, rounded);
    });
    std::uint32_t total = 0;
    for (int lane = 0; lane < kLanes; ++lane) total += std::uint32_t(sum[lane]);
    surplus = std::int32_t(128 * total);
  }

  typedef Ints Weights;
  static Weights decode(const unsigned char* weights) { return load_ints(weights); }

  Floats value(Ints sum, const PackedLayer& layer, int at) const {
    return QuantisedInputs::value(wrapping_sum(sum, Ints{} - surplus), layer, at);
  }
};

#if defined(__AVX512VNNI__) || defined(__AVXVNNI__)

// An integer q is 256 high + low with signed bytes (kInt8InputLimit). One instruction adds the products of four unsigned
// and four signed bytes. A row of inputs has the high ones and then the low ones.
struct Int8Rows : QuadInputs {
  struct Sum {
    Ints high, low;
  };
  static constexpr int kRegistersASum = 2;

  const unsigned char* rows;

  void prepare(const PackedLayer& layer, const DenseCall& call) {
    unsigned char* const bytes = reinterpret_cast<unsigned char*>(call.quantised);
    quantise(layer, call.input, [&](int i, Ints rounded) { store_bytes(bytes + 2 * i, rounded); });
    rows = bytes;
  }

  // By hand: GCC 12 converts to bytes one by one.
  static void store_bytes(unsigned char* bytes, Ints rounded) {
    typedef long long Rows __attribute__((vector_size(4 * kLanes)));
    typedef long long StoredRows __attribute__((vector_size(2 * kLanes), may_alias));
    const Rows order = Rows{} + 0x0c080400'0d090501;
    // The second byte of q + 128 is the high one, and the first, its first bit turned, the low one.
    const Ints both = wrapping_sum(rounded, Ints{} + 128) ^ 128;
#if defined(__AVX512VNNI__)
    const Rows all = (Rows)_mm512_shuffle_epi8((__m512i)both, (__m512i)order);
    *reinterpret_cast<StoredRows*>(bytes) = __builtin_shufflevector(all, all, 0, 2, 4, 6);
#else
    const Rows all = (Rows)_mm256_shuffle_epi8((__m256i)both, (__m256i)order);
    *reinterpret_cast<StoredRows*>(bytes) = __builtin_shufflevector(all, all, 0, 2);
#endif
  }

  struct Factor {
    Ints high, low;
  };
  Factor factor(int row) const {
    const unsigned char* at = rows + 2 * kInputs * row;
    return {Ints{} + word_at(at), Ints{} + word_at(at + kInputs)};
  }
  static void multiply_add(Weights weights, Factor quad, Sum* sum, int) {
    sum->high = add_quad_products(sum->high, weights, quad.high);
    sum->low = add_quad_products(sum->low, weights, quad.low);
  }

  Floats value(Sum sum, const PackedLayer& layer, int at) const {
    return QuadInputs::value(wrapping_sum(sum.high << 8, sum.low), layer, at);
  }
};

#else

// Inputs in 16 bits, the first and third of a row before its second and fourth: so network weights become 16-bit
// integers by a mask and a shift, which more of a processor's units do than widen bytes.
struct Int8Rows : QuadInputs {
  typedef Ints Sum;
  static constexpr int kRegistersASum = 1;

  const std::int16_t* quantised;

  void prepare(const PackedLayer& layer, const DenseCall& call) {
    typedef std::int16_t Shorts __attribute__((vector_size(2 * kLanes), may_alias));
    quantise(layer, call.input, [&](int i, Ints rounded) {
      const Ints turned = (Ints)turned_fours<0, 2, 1, 3>((Floats)rounded);
      *reinterpret_cast<Shorts*>(call.quantised + i) = __builtin_convertvector(turned, Shorts);
    });
    quantised = call.quantised;
  }

  struct Factor {
    Ints even, odd;
  };
  Factor factor(int row) const {
    const std::int16_t* at = quantised + kInputs * row;
    return {Ints{} + word_at(at), Ints{} + word_at(at + 2)};
  }
  static void multiply_add(Weights weights, Factor quad, Sum* sum, int) {
    typedef std::uint16_t Shorts __attribute__((vector_size(4 * kLanes)));
    *sum = add_pair_products(*sum, weights & 0x00ff00ff, quad.even);
    *sum = add_pair_products(*sum, (Ints)((Shorts)weights >> 8), quad.odd);
  }
};

#endif

#else

// Rows of two inputs, in 16 bits.
struct PairInputs : QuantisedInputs {
  static constexpr Int8Layout kLayout{2, 0};
  static constexpr int kInputs = 2;
  static constexpr int kSumsALoad = 1;
  static constexpr int bytes(int outputs) { return kInputs * outputs; }

  const std::int16_t* quantised;

  void prepare(const PackedLayer& layer, const DenseCall& call) {
    typedef std::int16_t Shorts __attribute__((vector_size(2 * kLanes), may_alias));
    quantise(layer, call.input, [&](int i, Ints rounded) {
      *reinterpret_cast<Shorts*>(call.quantised + i) = __builtin_convertvector(rounded, Shorts);
    });
    if (layer.inputs % kInputs != 0) call.quantised[layer.inputs] = 0;
    quantised = call.quantised;
  }

  std::int32_t pair(int row) const { return word_at(quantised + kInputs * row); }
};

#if !defined(__aarch64__)
struct Int8Rows : PairInputs {
  typedef Ints Sum;
  static constexpr int kRegistersASum = 1;

  typedef WidePairs Weights;
  static Weights decode(const unsigned char* weights) { return widen_pairs(weights); }
  Ints factor(int row) const { return Ints{} + pair(row); }
  static void multiply_add(Weights weights, Ints both, Sum* sum, int) { *sum = add_pair_products(*sum, weights, both); }
};
#endif

#endif

}  // namespace physkin::PHYSKIN_ISA

#if defined(__aarch64__)
#include "kernels/int8_rows_arm.hpp"
#endif

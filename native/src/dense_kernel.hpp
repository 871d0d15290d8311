// One dense layer with modulation and activation. Included by kernel_unit.cpp only (see simd.hpp).
#pragma once

#include "kernels.hpp"
#include "simd.hpp"
#include "simd_pairs.hpp"

namespace physkin::PHYSKIN_ISA {

// Eight independent sums hide the latency of the fused multiply-add. Every output has one sum, over its inputs in
// order: leaving out inputs that are zero changes no bit of it.
constexpr int kSums = 8;
constexpr int kPanel = kSums * kLanes;
static_assert(kPanel % kGroup == 0);

// values: (count,), whole vectors.
inline void activate(float* values, int count, Activation activation) {
  switch (activation) {
    case Activation::silu:
      for (int k = 0; k < count; k += kLanes) {
        const Floats v = load(values + k);
        store(values + k, v / (1.0f + exponential(-v)));
      }
      return;
    case Activation::relu:
      for (int k = 0; k < count; k += kLanes) store(values + k, at_least(load(values + k), 0.0f));
      return;
    case Activation::none: return;
  }
}

// --- Rows of network weights by precision: what a row is multiplied with, its bytes, and the sums it adds to. ---

struct Fp32Rows {
  typedef Floats Sum;
  static constexpr int kRegistersASum = 1;
  static constexpr int kInputs = 1;  // inputs a row
  static constexpr int bytes(int outputs) { return 4 * outputs; }

  const float* input;

  void prepare(const PackedLayer&, const float* layer_input, const DenseScratch&) { input = layer_input; }
  bool is_zero(int row) const { return input[row] == 0.0f; }

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
    for_each_vector(input, layer.inputs, [&](int i, Floats v) {
      store(i, (Ints)(v * scale + kRound) - (Ints)(Floats{} + kRound));
    });
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

#if defined(__AVX512VNNI__)

// Rows of four inputs. An integer q is 256 high + low with signed bytes (kInt8InputLimit), network weights are stored
// as w + 128, and one instruction adds the products of four unsigned and four signed bytes: the two sums over
// (w + 128) high and (w + 128) low make the sum over w q plus 128 times that over q. Exact: all is integer and modulo
// 2^32, and the sum over w q is within 32 bits.
struct Int8Rows : QuantisedInputs {
  struct Sum {
    Ints high, low;
  };
  static constexpr int kRegistersASum = 2;
  static constexpr Int8Layout kLayout = Int8Layout::quads;
  static constexpr int kInputs = 4;
  static constexpr int bytes(int outputs) { return kInputs * outputs; }

  const signed char *high, *low;
  std::int32_t surplus;  // 128 times the sum of all integers

  void prepare(const PackedLayer& layer, const float* input, const DenseScratch& scratch) {
    typedef signed char Bytes __attribute__((vector_size(kLanes), may_alias));
    signed char* const bytes = reinterpret_cast<signed char*>(scratch.quantised);
    const int padded = (layer.inputs + kLanes - 1) / kLanes * kLanes;
    Ints sum = {};
    quantise(layer, input, [&](int i, Ints rounded) {
      const Ints upper = wrapping_sum(rounded, Ints{} + 128) >> 8;
      *reinterpret_cast<Bytes*>(bytes + i) = __builtin_convertvector(upper, Bytes);
      *reinterpret_cast<Bytes*>(bytes + padded + i) = __builtin_convertvector(rounded, Bytes);
      sum = wrapping_sum(sum, rounded);
    });
    high = bytes;
    low = bytes + padded;
    std::uint32_t total = 0;
    for (int lane = 0; lane < kLanes; ++lane) total += std::uint32_t(sum[lane]);
    surplus = std::int32_t(128 * total);
  }
  bool is_zero(int row) const { return (word_at(high + kInputs * row) | word_at(low + kInputs * row)) == 0; }

  typedef Ints Weights;
  static constexpr int kSumsALoad = 1;
  static Weights decode(const unsigned char* weights) { return load_ints(weights); }
  struct Factor {
    Ints high, low;
  };
  Factor factor(int row) const {
    return {Ints{} + word_at(high + kInputs * row), Ints{} + word_at(low + kInputs * row)};
  }
  static void multiply_add(Weights weights, Factor quad, Sum* sum, int) {
    sum->high = add_quad_products(sum->high, weights, quad.high);
    sum->low = add_quad_products(sum->low, weights, quad.low);
  }

  Floats value(Sum sum, const PackedLayer& layer, int at) const {
    const Ints all = wrapping_sum(sum.high << 8, sum.low);
    return QuantisedInputs::value(wrapping_sum(all, Ints{} - surplus), layer, at);
  }
};

#else

struct Int8Rows : QuantisedInputs {
  typedef Ints Sum;
  static constexpr int kRegistersASum = 1;
  static constexpr Int8Layout kLayout = Int8Layout::pairs;
  static constexpr int kInputs = 2;
  static constexpr int bytes(int outputs) { return kInputs * outputs; }

  const std::int16_t* quantised;

  void prepare(const PackedLayer& layer, const float* input, const DenseScratch& scratch) {
    typedef std::int16_t Shorts __attribute__((vector_size(2 * kLanes), may_alias));
    quantise(layer, input, [&](int i, Ints rounded) {
      *reinterpret_cast<Shorts*>(scratch.quantised + i) = __builtin_convertvector(rounded, Shorts);
    });
    if (layer.inputs % kInputs != 0) scratch.quantised[layer.inputs] = 0;
    quantised = scratch.quantised;
  }

  std::int32_t pair(int row) const { return word_at(quantised + kInputs * row); }
  bool is_zero(int row) const { return pair(row) == 0; }

  typedef WidePairs Weights;
  static constexpr int kSumsALoad = 1;
  static Weights decode(const unsigned char* weights) { return widen_pairs(weights); }
  Ints factor(int row) const { return Ints{} + pair(row); }
  static void multiply_add(Weights weights, Ints both, Sum* sum, int) { *sum = add_pair_products(*sum, weights, both); }
};

#endif

// --- The layer ---

struct Modulation {
  const float* scale;
  const float* shift;
};

// Which rows a kernel reads, and whether it fetches them ahead of time. Listed rows lie too irregularly for the
// processor to do it by itself. With all rows, Zen 5 needs the instructions, as it stops at the end of every page by
// itself, and Zen 4 reads from L3 a quarter faster without them. Distances by measurement (Zen 5, weights in L3).
enum class Reading { all, all_ahead, listed };
constexpr int kListedRowsAhead = 12;
constexpr std::ptrdiff_t kBytesAhead = 4096;

inline void prefetch(const unsigned char* row, std::ptrdiff_t bytes) {
  for (std::ptrdiff_t at = 0; at < bytes; at += 64) __builtin_prefetch(row + at);
}

// kLanes outputs from their sum, before the activation.
template <class Rows>
inline void finish(const PackedLayer& layer, const Rows& rows, typename Rows::Sum sum, int at, Modulation modulation,
                   float* output) {
  Floats value = rows.value(sum, layer, at);
  if (modulation.scale != nullptr) {
    value = value * (1.0f + load_unaligned(modulation.scale + at)) + load_unaligned(modulation.shift + at);
  }
  store(output + at, value);
}

// kCount * kLanes outputs from `at` on. `listed`: the rows to read, if not all.
template <class Rows, Reading kReading, int kCount>
inline void dense_panel(const PackedLayer& layer, const Rows& rows, const unsigned char* weights,
                        const std::int32_t* listed, int row_count, int at, Modulation modulation, Activation activation,
                        float* output) {
  typename Rows::Sum sum[kCount] = {};
  constexpr std::ptrdiff_t kRow = Rows::bytes(kCount * kLanes);
  for (int k = 0; k < row_count; ++k) {
    const int row = kReading == Reading::listed ? listed[k] : k;
    if (kReading == Reading::all_ahead) prefetch(weights + row * kRow + kBytesAhead, kRow);
    if (kReading == Reading::listed && k + kListedRowsAhead < row_count) {
      prefetch(weights + listed[k + kListedRowsAhead] * kRow, kRow);
    }
    const auto x = rows.factor(row);
    for (int v = 0; v < kCount / Rows::kSumsALoad; ++v) {
      const auto w = Rows::decode(weights + row * kRow + v * Rows::bytes(Rows::kSumsALoad * kLanes));
      Rows::multiply_add(w, x, sum + v, kCount / 2);
    }
  }
#pragma GCC unroll 8
  for (int v = 0; v < kCount; ++v) finish(layer, rows, sum[v], at + v * kLanes, modulation, output);
  activate(output + at, kCount * kLanes, activation);
}

// The last panel of a layer may be narrower by whole groups.
template <class Rows, Reading kReading, int kCount = kSums, class... Arguments>
inline void dense_panel_of(int count, const Arguments&... arguments) {
  if (count == kCount) return dense_panel<Rows, kReading, kCount>(arguments...);
  if constexpr (kCount * kLanes > kGroup) dense_panel_of<Rows, kReading, kCount - kGroup / kLanes>(count, arguments...);
}

template <class Rows, Reading kReading>
void dense(const PackedLayer& layer, const float* input, const float* scale, const float* shift, Activation activation,
           const DenseScratch& scratch, float* output) {
  Rows rows;
  rows.prepare(layer, input, scratch);
  const int all_rows = (layer.inputs + Rows::kInputs - 1) / Rows::kInputs;
  int row_count = all_rows;
  if (kReading == Reading::listed) {
    row_count = 0;
    for (int row = 0; row < all_rows; ++row) {
      scratch.rows[row_count] = row;
      row_count += !rows.is_zero(row);
    }
  }
  const std::int32_t* listed = kReading == Reading::listed ? scratch.rows : nullptr;

  const unsigned char* weights = layer.weights;
  const int padded = padded_to_group(layer.outputs);
  for (int at = 0; at < padded; at += kPanel) {
    const int width = padded - at < kPanel ? padded - at : kPanel;
    dense_panel_of<Rows, kReading>(width / kLanes, layer, rows, weights, listed, row_count, at,
                                   Modulation{scale, shift}, activation, output);
    weights += std::ptrdiff_t(all_rows) * Rows::bytes(width);
  }
}

}  // namespace physkin::PHYSKIN_ISA

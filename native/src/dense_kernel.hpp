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

inline Floats activate(Floats v, Activation activation) {
  switch (activation) {
    case Activation::silu: return v / (1.0f + exponential(-v));
    case Activation::relu: return at_least(v, 0.0f);
    case Activation::none: break;
  }
  return v;
}

// --- Rows of network weights by precision: what a row is multiplied with, its bytes, and the sums it adds to. ---

struct Fp32Rows {
  typedef Floats Sum;
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

struct Int8Rows {
  typedef Ints Sum;
  static constexpr int kInputs = 2;
  static constexpr int bytes(int outputs) { return 2 * outputs; }

  const std::int16_t* quantised;
  float unit;  // input of 1 in integers; NaN if an input is not finite, as the layer's outputs must be then

  void prepare(const PackedLayer& layer, const float* input, const DenseScratch& scratch) {
    Floats largest = {}, poison = {};
    for (int i = 0; i < layer.inputs; i += kLanes) {
      const Floats v = inside(input, i, layer.inputs);
      const Floats magnitude = v < 0.0f ? -v : v;
      largest = magnitude > largest ? magnitude : largest;
      poison += v * 0.0f;
    }
    float most = 1e-30f, bad = 0.0f;
    for (int lane = 0; lane < kLanes; ++lane) {
      most = largest[lane] > most ? largest[lane] : most;
      bad += poison[lane];
    }
    unit = most / layer.input_limit + bad;
    const float scale = layer.input_limit / most;
    constexpr float kRound = 12582912.0f;  // 1.5 * 2^23: adding it rounds to an integer in the low bits
    typedef std::int16_t Shorts __attribute__((vector_size(2 * kLanes), may_alias));
    for (int i = 0; i < layer.inputs; i += kLanes) {
      const Ints rounded = (Ints)(inside(input, i, layer.inputs) * scale + kRound) - (Ints)(Floats{} + kRound);
      *reinterpret_cast<Shorts*>(scratch.quantised + i) = __builtin_convertvector(rounded, Shorts);
    }
    if (layer.inputs % 2 != 0) scratch.quantised[layer.inputs] = 0;
    quantised = scratch.quantised;
  }

  static Floats inside(const float* input, int i, int count) {
    Ints lane;
    for (int k = 0; k < kLanes; ++k) lane[k] = k;
    return lane + i < count ? load(input + i) : Floats{};
  }

  std::int32_t pair(int row) const {
    std::int32_t both;
    __builtin_memcpy(&both, quantised + 2 * row, sizeof both);
    return both;
  }
  bool is_zero(int row) const { return pair(row) == 0; }

  typedef WidePairs Weights;
  static constexpr int kSumsALoad = 1;
  static Weights decode(const unsigned char* weights) { return widen_pairs(weights); }
  Ints factor(int row) const { return Ints{} + pair(row); }
  static void multiply_add(Weights weights, Ints both, Sum* sum, int) { *sum = add_pair_products(*sum, weights, both); }

  Floats value(Sum sum, const PackedLayer& layer, int at) const {
    return __builtin_convertvector(sum, Floats) * (load(layer.output_scale + at) * unit) + load(layer.bias + at);
  }
};

// --- The layer ---

struct Modulation {
  const float* scale;
  const float* shift;
};

// Rows are fetched ahead of time: listed ones lie too irregularly for the processor to do it by itself, and with all
// rows it stops at the end of every page. Distances by measurement (Zen 5, weights in L3).
constexpr int kListedRowsAhead = 12;
constexpr std::ptrdiff_t kBytesAhead = 4096;

inline void prefetch(const unsigned char* row, std::ptrdiff_t bytes) {
  for (std::ptrdiff_t at = 0; at < bytes; at += 64) __builtin_prefetch(row + at);
}

// kLanes outputs from their sum.
template <class Rows>
inline void finish(const PackedLayer& layer, const Rows& rows, typename Rows::Sum sum, int at, Modulation modulation,
                   Activation activation, float* output) {
  Floats value = rows.value(sum, layer, at);
  if (modulation.scale != nullptr) {
    value = value * (1.0f + load_unaligned(modulation.scale + at)) + load_unaligned(modulation.shift + at);
  }
  store(output + at, activate(value, activation));
}

// kCount * kLanes outputs from `at` on. `listed`: the rows to read, if not all.
template <class Rows, bool kListed, int kCount>
inline void dense_panel(const PackedLayer& layer, const Rows& rows, const unsigned char* weights,
                        const std::int32_t* listed, int row_count, int at, Modulation modulation, Activation activation,
                        float* output) {
  typename Rows::Sum sum[kCount] = {};
  constexpr std::ptrdiff_t kRow = Rows::bytes(kCount * kLanes);
  for (int k = 0; k < row_count; ++k) {
    const int row = kListed ? listed[k] : k;
    if (!kListed) prefetch(weights + row * kRow + kBytesAhead, kRow);
    if (kListed && k + kListedRowsAhead < row_count) prefetch(weights + listed[k + kListedRowsAhead] * kRow, kRow);
    const auto x = rows.factor(row);
    for (int v = 0; v < kCount / Rows::kSumsALoad; ++v) {
      const auto w = Rows::decode(weights + row * kRow + v * Rows::bytes(Rows::kSumsALoad * kLanes));
      Rows::multiply_add(w, x, sum + v, kCount / 2);
    }
  }
  for (int v = 0; v < kCount; ++v, at += kLanes) finish(layer, rows, sum[v], at, modulation, activation, output);
}

// The last panel of a layer may be narrower by whole groups.
template <class Rows, bool kListed, int kCount = kSums, class... Arguments>
inline void dense_panel_of(int count, const Arguments&... arguments) {
  if (count == kCount) return dense_panel<Rows, kListed, kCount>(arguments...);
  if constexpr (kCount * kLanes > kGroup) dense_panel_of<Rows, kListed, kCount - kGroup / kLanes>(count, arguments...);
}

template <class Rows, bool kSkipZeros>
void dense(const PackedLayer& layer, const float* input, const float* scale, const float* shift, Activation activation,
           const DenseScratch& scratch, float* output) {
  Rows rows;
  rows.prepare(layer, input, scratch);
  const int all_rows = (layer.inputs + Rows::kInputs - 1) / Rows::kInputs;
  int row_count = all_rows;
  if (kSkipZeros) {
    row_count = 0;
    for (int row = 0; row < all_rows; ++row) {
      scratch.rows[row_count] = row;
      row_count += !rows.is_zero(row);
    }
  }
  const std::int32_t* listed = kSkipZeros ? scratch.rows : nullptr;

  const unsigned char* weights = layer.weights;
  const int padded = padded_to_group(layer.outputs);
  for (int at = 0; at < padded; at += kPanel) {
    const int width = padded - at < kPanel ? padded - at : kPanel;
    dense_panel_of<Rows, kSkipZeros>(width / kLanes, layer, rows, weights, listed, row_count, at,
                                     Modulation{scale, shift}, activation, output);
    weights += std::ptrdiff_t(all_rows) * Rows::bytes(width);
  }
}

}  // namespace physkin::PHYSKIN_ISA

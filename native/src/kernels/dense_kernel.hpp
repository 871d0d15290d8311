// One dense layer with modulation and activation. Included by kernel_unit.cpp only (see simd.hpp).
#pragma once

#include "kernels/dense_rows.hpp"
#include "kernels/kernels.hpp"
#include "kernels/simd.hpp"

namespace physkin::PHYSKIN_ISA {

// Eight independent sums hide the latency of the fused multiply-add. Every output has one sum, its inputs in order.
constexpr int kSums = 8;
constexpr int kPanel = kSums * kLanes;
static_assert(kPanel % kGroup == 0);

// How far ahead instructions fetch network weights: measured on Zen 5 and Emerald Rapids, in L3 and in memory.
constexpr std::ptrdiff_t kBytesAhead = 4096;

// values: (count,), whole vectors.
inline void activate(float* values, int count, Activation activation) {
  switch (activation) {
    case Activation::silu:
      for (int k = 0; k < count; k += kLanes) {
        const Floats v = load(values + k);
        store(values + k, v / (1.0f + exponential(-v)));
      }
      return;
    case Activation::none:
    case Activation::relu: return;  // no frame has it; the body encoder's is in token_kernel.hpp
  }
}

inline void prefetch(const void* data, std::ptrdiff_t bytes) {
  for (std::ptrdiff_t at = 0; at < bytes; at += 64) __builtin_prefetch(static_cast<const char*>(data) + at);
}

// kLanes outputs from their sum, before the activation.
template <class Rows>
inline void finish(const PackedLayer& layer, const Rows& rows, typename Rows::Sum sum, int at, const DenseCall& call) {
  Floats value = rows.value(sum, layer, at);
  if (call.scale != nullptr) {
    value = value * (1.0f + load_unaligned(call.scale + at)) + load_unaligned(call.shift + at);
  }
  store(call.output + at, value);
}

// Sums that stay in registers, besides network weights and inputs.
#if defined(__AVX512F__) || defined(__aarch64__)
constexpr int kRegisterSums = 16;
#else
constexpr int kRegisterSums = 8;
#endif

// Loads a pass over the rows takes of a panel of kCount * kLanes outputs, so that the sums fit.
template <class Rows>
constexpr int loads_a_pass(int count) {
  const int all = count / Rows::kSumsALoad;
  const int fit = kRegisterSums / (Rows::kSumsALoad * Rows::kRegistersASum);
  for (int loads = fit < all ? fit : all; loads > 1; --loads) {
    if (all % loads == 0) return loads;
  }
  return 1;
}

// Calls f(0) to f(kCount - 1) in line: GCC keeps an array in registers only where no loop indexes it.
template <int kCount, int k = 0, class F>
[[gnu::always_inline]] inline void unrolled(const F& f) {
  f(k);
  if constexpr (k + 1 < kCount) unrolled<kCount, k + 1>(f);
}

template <class Rows, bool kAhead, int kCount>
inline void dense_panel(const PackedLayer& layer, const Rows& rows, const unsigned char* weights, int row_count, int at,
                        const DenseCall& call, Activation activation) {
  constexpr int kPer = Rows::kSumsALoad, kLoads = loads_a_pass<Rows>(kCount), kAll = kCount / kPer;
  constexpr std::ptrdiff_t kRow = Rows::bytes(kCount * kLanes), kLoad = Rows::bytes(kPer * kLanes);
  for (int first = 0; first < kAll; first += kLoads) {
    typename Rows::Sum sum[kLoads * kPer] = {};
    const unsigned char* part = weights + first * kLoad;
    for (int row = 0; row < row_count; ++row, part += kRow) {
      if (kAhead) prefetch(part + kBytesAhead, kLoads * kLoad);
      const auto x = rows.factor(row);
      unrolled<kLoads>([&](int v) __attribute__((always_inline)) {
        Rows::multiply_add(Rows::decode(part + v * kLoad), x, sum + v, kLoads);
      });
    }
    unrolled<kLoads * kPer>([&](int k) __attribute__((always_inline)) {
      // A load's second sum belongs to the panel's second half.
      const int v = k < kLoads ? first + k : kCount / 2 + first + k - kLoads;
      finish(layer, rows, sum[k], at + v * kLanes, call);
    });
  }
  activate(call.output + at, kCount * kLanes, activation);
}

template <class Rows, bool kAhead, int kCount = kSums>
inline void dense_panel_of(int count, const PackedLayer& layer, const Rows& rows, const unsigned char* weights,
                           int row_count, int at, const DenseCall& call, Activation activation) {
  if (count == kCount) {
    return dense_panel<Rows, kAhead, kCount>(layer, rows, weights, row_count, at, call, activation);
  }
  if constexpr (kCount * kLanes > kGroup) {
    dense_panel_of<Rows, kAhead, kCount - kGroup / kLanes>(count, layer, rows, weights, row_count, at, call,
                                                           activation);
  }
}

template <class Rows, bool kAhead>
void dense(const PackedLayer& layer, Activation activation, const DenseCall& call) {
  Rows rows;
  rows.prepare(layer, call);
  const int row_count = (layer.inputs + Rows::kInputs - 1) / Rows::kInputs;
  const unsigned char* weights = layer.weights;
  const int padded = padded_to_group(layer.outputs);
  for (int at = 0; at < padded; at += kPanel) {
    const int width = padded - at < kPanel ? padded - at : kPanel;
    if (kAhead) {  // what a panel's sums meet when all rows are read
      prefetch(layer.bias + at, 4 * width);
      if (layer.output_scale != nullptr) prefetch(layer.output_scale + at, 4 * width);
    }
    dense_panel_of<Rows, kAhead>(width / kLanes, layer, rows, weights, row_count, at, call, activation);
    weights += std::ptrdiff_t(row_count) * Rows::bytes(width);
  }
}

}  // namespace physkin::PHYSKIN_ISA

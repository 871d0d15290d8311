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

// How far ahead instructions fetch network weights, by measurement (Zen 5, weights in L3).
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

inline void prefetch(const unsigned char* row, std::ptrdiff_t bytes) {
  for (std::ptrdiff_t at = 0; at < bytes; at += 64) __builtin_prefetch(row + at);
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
#pragma GCC unroll 8
      for (int v = 0; v < kLoads; ++v) Rows::multiply_add(Rows::decode(part + v * kLoad), x, sum + v, kLoads);
    }
#pragma GCC unroll 8
    for (int k = 0; k < kLoads * kPer; ++k) {
      // A load's second sum belongs to the panel's second half.
      const int v = k < kLoads ? first + k : kCount / 2 + first + k - kLoads;
      finish(layer, rows, sum[k], at + v * kLanes, call);
    }
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
    dense_panel_of<Rows, kAhead>(width / kLanes, layer, rows, weights, row_count, at, call, activation);
    weights += std::ptrdiff_t(row_count) * Rows::bytes(width);
  }
}

}  // namespace physkin::PHYSKIN_ISA

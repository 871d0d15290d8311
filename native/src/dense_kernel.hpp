// One dense layer with modulation and activation. Included by kernel_unit.cpp only (see simd.hpp).
#pragma once

#include "kernels.hpp"
#include "simd.hpp"

namespace physkin::PHYSKIN_ISA {

inline Floats activate(Floats v, Activation activation) {
  switch (activation) {
    case Activation::silu: return v / (1.0f + exponential(-v));
    case Activation::relu: return at_least(v, 0.0f);
    case Activation::none: break;
  }
  return v;
}

inline void dense(const PackedLayer& layer, const float* input, const float* scale, const float* shift,
                  Activation activation, float* output) {
  constexpr int kVectors = kPanel / kLanes;
  // Eight independent sums hide the latency of the fused multiply-add; narrow panels get them from several inputs.
  constexpr int kUnroll = 8 / kVectors;

  const float* weights = layer.weights;
  for (int panel = 0; panel < layer.outputs; panel += kPanel) {
    Floats sum[kUnroll][kVectors] = {};
    int i = 0;
    for (; i + kUnroll <= layer.inputs; i += kUnroll) {
      for (int u = 0; u < kUnroll; ++u) {
        for (int v = 0; v < kVectors; ++v) sum[u][v] += load(weights + v * kLanes) * input[i + u];
        weights += kPanel;
      }
    }
    for (; i < layer.inputs; ++i, weights += kPanel) {
      for (int v = 0; v < kVectors; ++v) sum[0][v] += load(weights + v * kLanes) * input[i];
    }
    for (int v = 0; v < kVectors; ++v) {
      const int at = panel + v * kLanes;
      Floats value = load(layer.bias + at);
      for (int u = 0; u < kUnroll; ++u) value += sum[u][v];
      if (scale != nullptr) value = value * (1.0f + load_unaligned(scale + at)) + load_unaligned(shift + at);
      store(output + at, activate(value, activation));
    }
  }
}

}  // namespace physkin::PHYSKIN_ISA

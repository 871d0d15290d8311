// Multilayer perceptron with optional scale and shift of every hidden activation: pose modulator and node deformer.
#pragma once

#include <vector>

#include "arena.hpp"
#include "kernels.hpp"

namespace physkin {

class Mlp {
 public:
  // Packs the network weights; the last layer is linear, the others are followed by the activation.
  Mlp(const std::vector<DenseWeights>& layers, Activation activation, Precision precision, const Kernels& kernels,
      Arena& arena);

  // input: 64-byte aligned, readable to a multiple of 64 bytes. modulation: [scale_0, shift_0, scale_1, shift_1, ...]
  // over the hidden activations, readable for kGroup floats beyond its end; null for none. Returns the outputs, valid
  // until the next run, readable for kGroup floats beyond.
  const float* run(const float* input, const float* modulation);

  // Whether network weights of zero activations are skipped. Changes the time a run takes, no bit of its result.
  void set_zero_skipping(bool skip) { skips_zeros_ = skip; }
  bool skips_zeros() const { return skips_zeros_; }

  int outputs() const { return layers_.back().outputs; }

 private:
  const Kernels& kernels_;
  Precision precision_;
  std::vector<PackedLayer> layers_;
  Activation activation_;
  bool skips_zeros_ = false;
  DenseScratch scratch_;
  float* buffers_[2];  // a layer reads one and writes the other
};

}  // namespace physkin

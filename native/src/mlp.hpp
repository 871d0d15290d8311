// Multilayer perceptron with optional scale and shift of every hidden activation: pose modulator and node deformer.
#pragma once

#include <vector>

#include "arena.hpp"
#include "kernels.hpp"

namespace physkin {

class Mlp {
 public:
  // Packs the network weights; the last layer is linear, the others are followed by the activation.
  Mlp(const std::vector<DenseWeights>& layers, Activation activation, Arena& arena);

  // modulation: [scale_0, shift_0, scale_1, shift_1, ...] over the hidden activations, readable for kPanel floats
  // beyond its end; null for none. Returns the outputs, valid until the next run, readable for kPanel floats beyond.
  const float* run(const Kernels& kernels, const float* input, const float* modulation);

  int outputs() const { return layers_.back().outputs; }

 private:
  std::vector<PackedLayer> layers_;
  Activation activation_;
  float* buffers_[2];  // a layer reads one and writes the other
};

}  // namespace physkin

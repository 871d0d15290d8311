// Multilayer perceptron with optional scale and shift of every hidden activation: pose modulator and node deformer.
#pragma once

#include <vector>

#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

class Mlp {
 public:
  // Packs the network weights, those of the first layer in a precision of their own; all layers but the last and
  // projections are followed by SiLU.
  Mlp(const std::vector<DenseWeights>& layers, Precision first, Precision others, const Kernels& kernels, Arena& arena);

  // input: 64-byte aligned, readable to a multiple of 64 bytes. modulation: [scale_0, shift_0, scale_1, shift_1, ...]
  // over the hidden activations, projections left out, readable for kGroup floats beyond its end; null for none. Returns the outputs, valid
  // until the next run, readable for kGroup floats beyond.
  const float* run(const float* input, const float* modulation);

  // What the last layer has read, as long as the outputs are valid; for two layers or more.
  const float* last_hidden() const { return buffers_[layers_.size() % 2]; }

  int outputs() const { return layers_.back().outputs; }
  // What a modulation has room for, including what is read beyond its end.
  std::size_t modulation_room() const;

 private:
  const DenseKernel (&dense_)[kPrecisionCount][2];
  bool fetch_ahead_;
  std::vector<PackedLayer> layers_;
  std::int16_t* quantised_;
  float* buffers_[2];  // a layer reads one and writes the other
};

}  // namespace physkin

// Multilayer perceptron with optional scale and shift of every hidden activation: pose modulator and node deformer.
#pragma once

#include <vector>

#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

class Mlp {
 public:
  // Packs the network weights, those of the first layer in a precision of their own; the last layer is linear, the
  // others are followed by the activation.
  // `shared`: a network that has the same layers from `first_shared` on, and lives longer; they are not packed again.
  Mlp(const std::vector<DenseWeights>& layers, Activation activation, Precision first, Precision others,
      const Kernels& kernels, Arena& arena, const Mlp* shared = nullptr, std::size_t first_shared = 0);

  // input: 64-byte aligned, readable to a multiple of 64 bytes. modulation: [scale_0, shift_0, scale_1, shift_1, ...]
  // over the hidden activations, readable for kGroup floats beyond its end; null for none. Returns the outputs, valid
  // until the next run, readable for kGroup floats beyond.
  const float* run(const float* input, const float* modulation);

  // One run of each network, bit for bit what `run` gives: layers that the networks share are read once for up to
  // kBatch of them. inputs, modulations, outputs: (count,) as `run` takes and returns them.
  static void run_batch(Mlp* const* networks, int count, const float* const* inputs, const float* const* modulations,
                        const float** outputs);

  int outputs() const { return layers_.back().outputs; }

 private:
  DenseCall call(std::size_t layer, const float* input, const float* modulation);

  const DenseKernel (&dense_)[kPrecisionCount][2];
  bool fetch_ahead_;
  std::vector<PackedLayer> layers_;
  Activation activation_;
  std::int16_t* quantised_;
  float* buffers_[2];  // a layer reads one and writes the other
};

}  // namespace physkin

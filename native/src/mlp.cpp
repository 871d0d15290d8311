#include "mlp.hpp"

#include <algorithm>

namespace physkin {

Mlp::Mlp(const std::vector<DenseWeights>& layers, Activation activation, Precision precision, const Kernels& kernels,
         Arena& arena)
    : kernels_(kernels), precision_(precision), activation_(activation) {
  int widest = 0;
  for (const DenseWeights& layer : layers) {
    layers_.push_back(pack_layer(layer, precision, kernels.panel, arena));
    widest = std::max({widest, layer.inputs, layer.outputs});
  }
  for (float*& buffer : buffers_) buffer = arena.take<float>(padded_to_group(widest) + kGroup);
  scratch_ = {arena.take<std::int32_t>(widest + kGroup), arena.take<std::int16_t>(widest + kGroup)};
}

const float* Mlp::run(const float* input, const float* modulation) {
  for (std::size_t k = 0; k < layers_.size(); ++k) {
    const PackedLayer& layer = layers_[k];
    const bool hidden = k + 1 < layers_.size();
    const float* scale = hidden ? modulation : nullptr;
    const float* shift = scale == nullptr ? nullptr : scale + layer.outputs;
    float* output = buffers_[k % 2];
    // The network's own input has no zeros worth looking for.
    const bool skip = skips_zeros_ && k > 0;
    const DenseKernel dense = (skip ? kernels_.dense_skipping : kernels_.dense)[int(precision_)];
    dense(layer, input, scale, shift, hidden ? activation_ : Activation::none, scratch_, output);
    if (modulation != nullptr) modulation += 2 * layer.outputs;
    input = output;
  }
  return input;
}

}  // namespace physkin

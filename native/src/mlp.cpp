#include "mlp.hpp"

#include <algorithm>

namespace physkin {
namespace {

PackedLayer pack(const DenseWeights& layer, Arena& arena) {
  const int padded = padded_to_panel(layer.outputs);
  float* weights = arena.take<float>(std::size_t(padded) * layer.inputs);
  float* bias = arena.take<float>(padded);
  for (int row = 0; row < layer.outputs; ++row) {
    const int panel = row / kPanel, lane = row % kPanel;
    float* column = weights + std::size_t(panel) * layer.inputs * kPanel + lane;
    for (int i = 0; i < layer.inputs; ++i) column[i * kPanel] = layer.matrix[std::size_t(row) * layer.inputs + i];
    bias[row] = layer.bias[row];
  }
  return {layer.inputs, layer.outputs, weights, bias};
}

}  // namespace

Mlp::Mlp(const std::vector<DenseWeights>& layers, Activation activation, Arena& arena) : activation_(activation) {
  int widest = 0;
  for (const DenseWeights& layer : layers) {
    layers_.push_back(pack(layer, arena));
    widest = std::max(widest, layer.outputs);
  }
  for (float*& buffer : buffers_) buffer = arena.take<float>(padded_to_panel(widest) + kPanel);
}

const float* Mlp::run(const Kernels& kernels, const float* input, const float* modulation) {
  for (std::size_t k = 0; k < layers_.size(); ++k) {
    const PackedLayer& layer = layers_[k];
    const bool hidden = k + 1 < layers_.size();
    const float* scale = hidden ? modulation : nullptr;
    const float* shift = scale == nullptr ? nullptr : scale + layer.outputs;
    float* output = buffers_[k % 2];
    kernels.dense(layer, input, scale, shift, hidden ? activation_ : Activation::none, output);
    if (modulation != nullptr) modulation += 2 * layer.outputs;
    input = output;
  }
  return input;
}

}  // namespace physkin

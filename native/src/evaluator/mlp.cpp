#include "evaluator/mlp.hpp"

#include <algorithm>

#include "kernels/dispatch.hpp"
#include "kernels/shared.hpp"

namespace physkin {
namespace {

// Packed once for all networks that have this layer.
PackedLayer pack_once(const DenseWeights& layer, Precision precision, const PackedLayout& layout, Arena& arena) {
  Digest digest;
  digest.add(precision).add(layout.panel).add(layout.int8.inputs).add(layout.int8.added).add(layer.outputs);
  digest.add(layer.matrix, std::size_t(layer.outputs) * std::size_t(layer.inputs));
  if (!layer.is_projection()) digest.add(layer.bias, std::size_t(layer.outputs));
  return shared_in<PackedLayer>(arena, digest, [&](Arena& own) { return pack_layer(layer, precision, layout, own); });
}

}  // namespace

Mlp::Mlp(const std::vector<DenseWeights>& layers, Precision first, Precision others, const Kernels& kernels,
         Arena& arena)
    : dense_(kernels.dense), fetch_ahead_(fetches_ahead()) {
  int widest = 0;
  for (const DenseWeights& layer : layers) {
    layers_.push_back(pack_once(layer, layers_.empty() ? first : others, kernels.layout, arena));
    widest = std::max({widest, layer.inputs, layer.outputs});
  }
  for (float*& buffer : buffers_) buffer = arena.take<float>(padded_to_group(widest) + kGroup);
  quantised_ = arena.take<std::int16_t>(widest + kGroup);
}

std::size_t Mlp::modulation_room() const {
  std::size_t room = kGroup;
  for (std::size_t k = 0; k + 1 < layers_.size(); ++k) {
    if (!layers_[k].is_projection) room += 2 * std::size_t(layers_[k].outputs);
  }
  return room;
}

const float* Mlp::run(const float* input, const float* modulation) {
  for (std::size_t k = 0; k < layers_.size(); ++k) {
    const PackedLayer& layer = layers_[k];
    const bool hidden = k + 1 < layers_.size() && !layer.is_projection;
    const float* scale = hidden ? modulation : nullptr;
    const float* shift = scale == nullptr ? nullptr : scale + layer.outputs;
    float* output = buffers_[k % 2];
    dense_[int(layer.precision)][fetch_ahead_](layer, hidden ? Activation::silu : Activation::none,
                                               {input, scale, shift, quantised_, output});
    if (scale != nullptr) modulation += 2 * layer.outputs;
    input = output;
  }
  return input;
}

}  // namespace physkin

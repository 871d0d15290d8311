#include "evaluator/mlp.hpp"

#include <algorithm>

#include "kernels/dispatch.hpp"

namespace physkin {

Mlp::Mlp(const std::vector<DenseWeights>& layers, Activation activation, Precision first, Precision others,
         const Kernels& kernels, Arena& arena, const Mlp* shared, std::size_t first_shared)
    : dense_(kernels.dense), fetch_ahead_(fetches_ahead()), activation_(activation) {
  int widest = 0;
  for (const DenseWeights& layer : layers) {
    const std::size_t k = layers_.size();
    const bool packed = shared != nullptr && k >= first_shared;
    const Precision precision = k == 0 ? first : others;
    layers_.push_back(packed ? shared->layers_[k] : pack_layer(layer, precision, kernels.layout, arena));
    widest = std::max({widest, layer.inputs, layer.outputs});
  }
  for (float*& buffer : buffers_) buffer = arena.take<float>(padded_to_group(widest) + kGroup);
  quantised_ = arena.take<std::int16_t>(widest + kGroup);
}

DenseCall Mlp::call(std::size_t k, const float* input, const float* modulation) {
  const float* scale = k + 1 < layers_.size() ? modulation : nullptr;
  const float* shift = scale == nullptr ? nullptr : scale + layers_[k].outputs;
  return {input, scale, shift, quantised_, buffers_[k % 2]};
}

const float* Mlp::run(const float* input, const float* modulation) {
  Mlp* const self = this;
  const float* output;
  run_batch(&self, 1, &input, &modulation, &output);
  return output;
}

void Mlp::run_batch(Mlp* const* networks, int count, const float* const* inputs, const float* const* modulations,
                    const float** outputs) {
  const Mlp& first = *networks[0];
  std::size_t modulated = 0;
  for (std::size_t k = 0; k < first.layers_.size(); ++k) {
    const Activation activation = k + 1 < first.layers_.size() ? first.activation_ : Activation::none;
    for (int begin = 0; begin < count;) {
      const PackedLayer& layer = networks[begin]->layers_[k];
      DenseCall calls[kBatch];
      int together = 0;
      for (int body = begin; together < kBatch && body < count; ++body, ++together) {
        if (networks[body]->layers_[k].weights != layer.weights) break;
        const float* input = k == 0 ? inputs[body] : outputs[body];
        const float* modulation = modulations[body] == nullptr ? nullptr : modulations[body] + modulated;
        calls[together] = networks[body]->call(k, input, modulation);
        outputs[body] = calls[together].output;
      }
      first.dense_[int(layer.precision)][first.fetch_ahead_](layer, activation, calls, together);
      begin += together;
    }
    modulated += 2 * std::size_t(first.layers_[k].outputs);
  }
}

}  // namespace physkin

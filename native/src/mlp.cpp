#include "mlp.hpp"

#include <algorithm>

namespace physkin {

Mlp::Mlp(const std::vector<DenseWeights>& layers, Activation activation, Precision first, Precision others,
         const Kernels& kernels, Arena& arena, const Mlp* shared, std::size_t first_shared)
    : kernels_(kernels), activation_(activation) {
  int widest = 0;
  for (const DenseWeights& layer : layers) {
    const std::size_t k = layers_.size();
    const bool packed = shared != nullptr && k >= first_shared;
    const Precision precision = k == 0 ? first : others;
    layers_.push_back(packed ? shared->layers_[k] : pack_layer(layer, precision, kernels.layout, arena));
    widest = std::max({widest, layer.inputs, layer.outputs});
  }
  if (shared != nullptr) reading_ = shared->reading_;
  for (float*& buffer : buffers_) buffer = arena.take<float>(padded_to_group(widest) + kGroup);
  scratch_ = {arena.take<std::int32_t>(widest + kGroup), arena.take<std::int16_t>(widest + kGroup)};
}

DenseCall Mlp::call(std::size_t k, const float* input, const float* modulation) {
  const float* scale = k + 1 < layers_.size() ? modulation : nullptr;
  const float* shift = scale == nullptr ? nullptr : scale + layers_[k].outputs;
  return {input, scale, shift, scratch_, buffers_[k % 2]};
}

const float* Mlp::run(const float* input, const float* modulation) {
  for (std::size_t k = 0; k < layers_.size(); ++k) {
    const PackedLayer& layer = layers_[k];
    const Activation activation = k + 1 < layers_.size() ? activation_ : Activation::none;
    const DenseCall now = call(k, input, modulation);
    // The network's own input has no zeros worth looking for.
    const bool skip = reading_.skip_zeros && k > 0;
    const DenseKernel dense = skip ? kernels(layer).nonzero : kernels(layer).all[reading_.fetch_ahead];
    dense(layer, now.input, now.scale, now.shift, activation, now.scratch, now.output);
    if (modulation != nullptr) modulation += 2 * layer.outputs;
    input = now.output;
  }
  return input;
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
      first.kernels(layer).batch[first.reading_.fetch_ahead](layer, activation, calls, together);
      begin += together;
    }
    modulated += 2 * std::size_t(first.layers_[k].outputs);
  }
}

}  // namespace physkin

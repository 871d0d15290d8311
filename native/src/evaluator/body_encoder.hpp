// The hyper modulator: points on a body -> modulation of the pose modulator (paper: Hyper Modulator). Once a body.
#pragma once

#include <vector>

#include "kernels/kernels.hpp"

namespace physkin {

constexpr int kEncodingFrequencies = 6;
constexpr int kTokenFeatures = 3 + 6 * kEncodingFrequencies + 3;
constexpr int kHeads = 4;

// Views of the caller's arrays. D is the token width, a multiple of kHeads.
struct BodyEncoder {
  struct Residual {
    LayerNorm norm;
    DenseWeights first, second;
  };

  DenseWeights embed;                              // (D, kTokenFeatures)
  DenseWeights attention_input, attention_output;  // (3 D, D) queries, keys, values; (D, D)
  LayerNorm norm_1, norm_2;
  DenseWeights feed_forward_0, feed_forward_1;  // (any, D), (D, any)
  DenseWeights pool;                            // (1, D)
  std::vector<Residual> residual;
  DenseWeights output;  // (any, D)
};

// points (count, 3) in metres, canonical pose, and unit normals (count, 3) -> output.outputs numbers. The same as
// physkin_core/hyper_modulator.py. Throws std::invalid_argument if layers do not fit each other, there is no point, a
// value is not finite or absurdly large, or the result is; `modulation` is then unchanged.
void encode_body(const BodyEncoder& encoder, const Kernels& kernels, const float* points, const float* normals,
                 int count, float* modulation);

}  // namespace physkin

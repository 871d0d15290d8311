#include "evaluator/body_encoder.hpp"

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <stdexcept>
#include <string>

#include "garment/finite.hpp"
#include "kernels/arena.hpp"

namespace physkin {
namespace {

constexpr double kPi = 3.14159265358979323846;

void check_layer(const char* name, const DenseWeights& layer, int outputs, int inputs) {
  if (layer.outputs != outputs || layer.inputs != inputs) {
    throw std::invalid_argument(std::string(name) + " has shape (" + std::to_string(layer.outputs) + ", " +
                                std::to_string(layer.inputs) + "); expected (" + std::to_string(outputs) + ", " +
                                std::to_string(inputs) + ")");
  }
  check_finite(name, layer.matrix, std::size_t(outputs) * inputs);
  check_finite(std::string(name) + " bias", layer.bias, outputs);
}

void check_norm(const char* name, const LayerNorm& norm, int width) {
  if (norm.width != width) {
    throw std::invalid_argument(std::string(name) + " has " + std::to_string(norm.width) + " features; expected " +
                                std::to_string(width));
  }
  check_finite(name, norm.weight, width);
  check_finite(std::string(name) + " bias", norm.bias, width);
}

void validate(const BodyEncoder& e) {
  const int width = e.embed.outputs;
  if (width < kHeads || width % kHeads != 0) {
    throw std::invalid_argument("token width is " + std::to_string(width) + "; must be a positive multiple of " +
                                std::to_string(kHeads) + " heads");
  }
  check_layer("embed", e.embed, width, kTokenFeatures);
  check_layer("attention.input", e.attention_input, 3 * width, width);
  check_layer("attention.output", e.attention_output, width, width);
  check_norm("norm_1", e.norm_1, width);
  check_layer("feed_forward.0", e.feed_forward_0, e.feed_forward_0.outputs, width);
  check_layer("feed_forward.1", e.feed_forward_1, width, e.feed_forward_0.outputs);
  check_norm("norm_2", e.norm_2, width);
  check_layer("pool", e.pool, 1, width);
  for (const BodyEncoder::Residual& block : e.residual) {
    check_norm("residual norm", block.norm, width);
    check_layer("residual.0", block.first, block.first.outputs, width);
    check_layer("residual.1", block.second, width, block.first.outputs);
  }
  check_layer("output", e.output, e.output.outputs, width);
}

// Positional encoding of one token, in double as the reference's: x, sin(2^k pi x), cos(2^k pi x) by axis, the normal.
void encode_point(const float* point, const float* normal, float* column) {
  for (int axis = 0; axis < 3; ++axis) {
    column[axis * kTokens] = point[axis];
    for (int k = 0; k < kEncodingFrequencies; ++k) {
      const double angle = double(point[axis]) * (kPi * double(1 << k));
      const int at = 3 + axis * kEncodingFrequencies + k;
      column[at * kTokens] = float(std::sin(angle));
      column[(at + 3 * kEncodingFrequencies) * kTokens] = float(std::cos(angle));
    }
    column[(kTokenFeatures - 3 + axis) * kTokens] = normal[axis];
  }
}

// The single vector after pooling takes no time; in double it adds no error of its own.
using Values = std::vector<double>;

Values linear(const DenseWeights& layer, const Values& x) {
  Values result(layer.bias, layer.bias + layer.outputs);
  for (int row = 0; row < layer.outputs; ++row) {
    const float* weights = layer.matrix + std::size_t(row) * layer.inputs;
    double sum = 0;
    for (int k = 0; k < layer.inputs; ++k) sum += double(weights[k]) * x[k];
    result[row] += sum;
  }
  return result;
}

Values layer_norm(const LayerNorm& norm, Values x) {
  double mean = 0, variance = 0;
  for (double value : x) mean += value / double(x.size());
  for (double value : x) variance += (value - mean) * (value - mean) / double(x.size());
  const double deviation = std::sqrt(variance + kLayerNormEpsilon);
  for (std::size_t k = 0; k < x.size(); ++k) x[k] = (x[k] - mean) / deviation * norm.weight[k] + norm.bias[k];
  return x;
}

// Softmax of the tokens' logits, then the tokens' sum with these shares.
Values pooled(const float* tokens, const std::vector<float>& logits, int width) {
  double largest = logits[0];
  for (float logit : logits) largest = std::max(largest, double(logit));
  Values sum(width, 0.0);
  double total = 0;
  for (std::size_t i = 0; i < logits.size(); ++i) {
    const double share = std::exp(logits[i] - largest);
    const float* token = tokens + i / kTokens * width * kTokens + i % kTokens;
    for (int k = 0; k < width; ++k) sum[k] += share * token[std::size_t(k) * kTokens];
    total += share;
  }
  for (double& value : sum) value /= total;
  return sum;
}

}  // namespace

void encode_body(const BodyEncoder& e, const Kernels& kernels, const float* points, const float* normals, int count,
                 float* modulation) {
  validate(e);
  if (count < 1) throw std::invalid_argument("there are no points to encode a body from");
  check_finite("points", points, 3 * std::size_t(count));
  check_finite("normals", normals, 3 * std::size_t(count));

  const int width = e.embed.outputs, tiles = (count + kTokens - 1) / kTokens, head_width = width / kHeads;
  const std::size_t tile = std::size_t(width) * kTokens;
  Arena arena;
  float* tokens = arena.take<float>(tiles * tile);
  float* projected = arena.take<float>(3 * tiles * tile);  // queries, keys, values of a tile, then those of the next
  float* scratch = arena.take<float>(attention_scratch(head_width));
  float* features = arena.take<float>(kTokenFeatures * kTokens);
  float* hidden = arena.take<float>(std::size_t(e.feed_forward_0.outputs) * kTokens);
  float* added = arena.take<float>(tile);
  float* tile_logits = arena.take<float>(kTokens);

  for (int t = 0; t < tiles; ++t) {
    const int first = t * kTokens, last = std::min(first + kTokens, count);
    for (int i = first; i < last; ++i) encode_point(points + 3 * i, normals + 3 * i, features + (i - first));
    kernels.token_linear(e.embed, features, Activation::none, tokens + t * tile);
    kernels.token_linear(e.attention_input, tokens + t * tile, Activation::none, projected + 3 * t * tile);
  }
  for (int head = 0; head < kHeads; ++head) {  // head by head: its keys and values stay in the cache
    float* queries = projected + std::size_t(head) * head_width * kTokens;
    const TokenAttention attention{head_width,
                                   count,
                                   1.0f / std::sqrt(float(head_width)),
                                   queries + tile,
                                   queries + 2 * tile,
                                   std::ptrdiff_t(3 * tile)};
    for (int t = 0; t < tiles; ++t) kernels.token_attention(attention, queries + 3 * t * tile, scratch);
  }
  std::vector<float> logits(count);
  for (int t = 0; t < tiles; ++t) {
    float* token = tokens + t * tile;
    kernels.token_linear(e.attention_output, projected + 3 * t * tile, Activation::none, added);
    kernels.token_norm(e.norm_1, added, token);
    kernels.token_linear(e.feed_forward_0, token, Activation::relu, hidden);
    kernels.token_linear(e.feed_forward_1, hidden, Activation::none, added);
    kernels.token_norm(e.norm_2, added, token);
    kernels.token_linear(e.pool, token, Activation::none, tile_logits);
    std::copy_n(tile_logits, std::min(kTokens, count - t * kTokens), logits.begin() + t * kTokens);
  }

  Values body = pooled(tokens, logits, width);
  for (const BodyEncoder::Residual& block : e.residual) {
    Values inner = linear(block.first, layer_norm(block.norm, body));
    for (double& value : inner) value = value < 0 ? 0 : value;  // keeps a NaN
    const Values step = linear(block.second, inner);
    for (int k = 0; k < width; ++k) body[k] += step[k];
  }
  const Values result = linear(e.output, body);
  const std::vector<float> rounded(result.begin(), result.end());
  check_finite("modulation", rounded.data(), rounded.size(), FLT_MAX);
  std::copy(rounded.begin(), rounded.end(), modulation);
}

}  // namespace physkin

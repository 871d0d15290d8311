#include "kernels/packed_layer.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <vector>

namespace physkin {
namespace {

std::uint32_t bits(float value) {
  std::uint32_t word;
  std::memcpy(&word, &value, sizeof word);
  return word;
}

float from_bits(std::uint32_t word) {
  float value;
  std::memcpy(&value, &word, sizeof value);
  return value;
}

// Smaller network weights count as zero: no sum notices them, and no product of theirs becomes a denormal number, which
// costs some processors a hundred cycles.
constexpr float kSmallest = 1e-18f;

// The nearest 16-bit float (ties to even), in the low half.
std::uint32_t low_half(float weight) {
  if (std::fabs(weight) < kSmallest) return 0;
  const std::uint32_t word = bits(weight);
  return (word + 0x7fffu + (word >> 16 & 1u)) >> 16;
}

// The word that is nearest to `weight` among those with the given low half.
std::uint32_t word_with_low_half(float weight, std::uint32_t low) {
  if (std::fabs(weight) < kSmallest) weight = std::copysign(kSmallest, weight);
  const std::uint32_t high = bits(weight) & 0xffff0000u;
  std::uint32_t nearest = high | low;
  for (const std::uint32_t candidate : {(high - 0x10000u) | low, (high + 0x10000u) | low}) {
    if (std::fabs(from_bits(candidate) - weight) < std::fabs(from_bits(nearest) - weight)) nearest = candidate;
  }
  return nearest;
}

// Walks the layer in the order of memory: place(at, row of inputs, panel's first output, its width), `at` being the
// start of a row in units of `width`.
template <class Place>
void for_each_row(const DenseWeights& layer, int rows, int panel, Place place) {
  const int padded = padded_to_group(layer.outputs);
  std::size_t at = 0;
  for (int first = 0; first < padded; first += panel) {
    const int width = std::min(panel, padded - first);
    for (int row = 0; row < rows; ++row, at += std::size_t(width)) place(at, row, first, width);
  }
}

float weight_at(const DenseWeights& layer, int output, int input) {
  const bool inside = output < layer.outputs && input < layer.inputs;
  return inside ? layer.matrix[std::size_t(output) * layer.inputs + input] : 0.0f;
}

// The nearest integer, halves away from zero: as std::lround, which is a call for every weight. The number added is the
// largest below a half: half itself would round what lies just below up.
int nearest(float value) { return int(value + std::copysign(0x1.fffffep-2f, value)); }

const unsigned char* as_bytes(const void* data) { return static_cast<const unsigned char*>(data); }

void pack_fp32(const DenseWeights& layer, int panel, Arena& arena, PackedLayer& packed) {
  auto* weights = arena.take<float>(std::size_t(padded_to_group(layer.outputs)) * layer.inputs);
  for_each_row(layer, layer.inputs, panel, [&](std::size_t at, int input, int first, int width) {
    for (int k = 0; k < width; ++k) weights[at + k] = weight_at(layer, first + k, input);
  });
  packed.weights = as_bytes(weights);
}

void pack_bf16(const DenseWeights& layer, int panel, Arena& arena, PackedLayer& packed) {
  auto* words = arena.take<std::uint32_t>(std::size_t(padded_to_group(layer.outputs)) / 2 * layer.inputs);
  for_each_row(layer, layer.inputs, panel, [&](std::size_t at, int input, int first, int width) {
    for (int k = 0; k < width / 2; ++k) {
      const std::uint32_t low = low_half(weight_at(layer, first + k, input));
      words[at / 2 + k] = word_with_low_half(weight_at(layer, first + width / 2 + k, input), low);
    }
  });
  packed.weights = as_bytes(words);
}

// The network weights of one output in 8 bits, each more by `offset`, and the sum of their magnitudes.
struct Rounded {
  float scale = 0.0f;
  std::int64_t sum = 0;
};

Rounded round_output(const float* weights, int inputs, int offset, std::uint8_t* rounded) {
  Rounded result;
  std::int32_t largest = 0;  // magnitudes as words, which have their order and are compared in vector registers
  for (int i = 0; i < inputs; ++i) largest = std::max(largest, std::int32_t(bits(weights[i]) & 0x7fffffffu));
  result.scale = std::max(from_bits(std::uint32_t(largest)) / 127.0f, 1e-30f);
  for (int i = 0; i < inputs; ++i) {
    const int value = std::clamp(nearest(weights[i] / result.scale), -127, 127);
    rounded[i] = std::uint8_t(value + offset);
    result.sum += std::abs(value);
  }
  return result;
}

// kTogether inputs of an output lie side by side, and so do the outputs of a panel. rounded: (outputs, kTogether rows).
template <int kTogether>
void lay_out(const DenseWeights& layer, int rows, int panel, const std::uint8_t* rounded, std::uint8_t* weights) {
  for_each_row(layer, rows, panel, [&](std::size_t at, int row, int first, int width) {
    const int count = std::min(width, layer.outputs - first);
    for (int k = 0; k < count; ++k) {
      const std::size_t from = std::size_t(first + k) * std::size_t(rows) + std::size_t(row);
      std::memcpy(weights + kTogether * (at + std::size_t(k)), rounded + kTogether * from, kTogether);
    }
  });
}

void pack_int8(const DenseWeights& layer, PackedLayout layout, Arena& arena, PackedLayer& packed) {
  const int together = layout.int8.inputs, offset = layout.int8.added;
  const int rows = (layer.inputs + together - 1) / together;
  const std::size_t padded = padded_to_group(layer.outputs), in_output = std::size_t(together) * std::size_t(rows);
  auto* weights = arena.take<std::uint8_t>(padded * in_output);
  auto* scale = arena.take<float>(padded);
  std::vector<std::uint8_t> rounded(std::size_t(layer.outputs) * in_output, std::uint8_t(offset));
  std::int64_t largest_sum = 1;
  for (int output = 0; output < layer.outputs; ++output) {
    const float* given = layer.matrix + std::size_t(output) * std::size_t(layer.inputs);
    const Rounded made = round_output(given, layer.inputs, offset, rounded.data() + std::size_t(output) * in_output);
    scale[output] = made.scale;
    largest_sum = std::max(largest_sum, made.sum);
  }
  (together == 2   ? lay_out<2>
   : together == 4 ? lay_out<4>
                   : lay_out<8>)(layer, rows, layout.panel, rounded.data(), weights);
  packed.weights = as_bytes(weights);
  packed.output_scale = scale;
  packed.input_limit = float(std::min<std::int64_t>(kInt8InputLimit, 0x7fffffff / largest_sum));
}

}  // namespace

PackedLayer pack_layer(const DenseWeights& layer, Precision precision, PackedLayout layout, Arena& arena) {
  PackedLayer packed;
  packed.precision = precision;
  packed.inputs = layer.inputs;
  packed.outputs = layer.outputs;
  switch (precision) {
    case Precision::fp32: pack_fp32(layer, layout.panel, arena, packed); break;
    case Precision::bf16: pack_bf16(layer, layout.panel, arena, packed); break;
    case Precision::int8: pack_int8(layer, layout, arena, packed); break;
  }
  auto* bias = arena.take<float>(padded_to_group(layer.outputs));
  packed.is_projection = layer.is_projection();
  if (!packed.is_projection) std::copy_n(layer.bias, layer.outputs, bias);
  packed.bias = bias;
  return packed;
}

}  // namespace physkin

// One dense layer of a network as a garment model holds it, and as the kernels read it.
#pragma once

#include <cstdint>

#include "kernels/arena.hpp"

namespace physkin {

enum class Activation { none, silu, relu };

struct DenseWeights {
  int outputs = 0, inputs = 0;
  const float* matrix = nullptr;  // (outputs, inputs)
  const float* bias = nullptr;    // (outputs,); none of a projection, which has neither modulation nor activation
  bool is_projection() const { return bias == nullptr; }
};

// Of network weights. fp32: the reference. bf16: 16-bit floats, widened in registers, activations in fp32. int8: 8-bit
// integers with one scale an output, activations rounded to 16-bit integers layer by layer; the layers that read bone
// transforms and the pose vector in bf16.
enum class Precision { fp32, bf16, int8 };
constexpr int kPrecisionCount = 3;

// Outputs are padded to whole groups, and computed in panels of several groups: as many as the registers of an
// instruction set hold sums for. The last panel of a layer may be narrower.
constexpr int kGroup = 32;

constexpr int padded_to_group(int count) { return (count + kGroup - 1) / kGroup * kGroup; }

// Inputs whose 8-bit network weights lie side by side, and what is added to each of these, so that unsigned bytes hold it.
struct Int8Layout {
  int inputs, added;
};

// What the kernels of an instruction set read.
struct PackedLayout {
  int panel;  // outputs computed at once, a multiple of kGroup
  Int8Layout int8;
};

// Inputs of 8-bit network weights are rounded to integers up to this: 256 high + low with both from -127 to 127.
constexpr int kInt8InputLimit = 127 * 257;

// Within a panel of `width` outputs the network weights of one input lie together, its row: an input is one broadcast,
// there is no horizontal sum, and memory is read in order. Zeros beyond the outputs.
//   fp32: weights[panel][input][width] float.
//   bf16: weights[panel][input][width / 2] 32-bit words, the low half output k, the high half output k + width / 2. The
//         kernel takes the word itself for the latter, so the high half is chosen to make the whole word the nearest.
//   int8: weights[panel][row of inputs][width][Int8Layout::inputs] bytes, more by Int8Layout::added than the network
//         weight; to be multiplied by output_scale.
struct PackedLayer {
  Precision precision = Precision::fp32;
  int inputs = 0, outputs = 0;
  const unsigned char* weights = nullptr;  // 64-byte aligned
  bool is_projection = false;
  const float* bias = nullptr;          // (padded outputs), zeros of a projection
  const float* output_scale = nullptr;  // (padded outputs), int8 only
  // int8 only: the largest |input| that no sum overflows with, at most kInt8InputLimit.
  float input_limit = 0.0f;
};

PackedLayer pack_layer(const DenseWeights& layer, Precision precision, PackedLayout layout, Arena& arena);

}  // namespace physkin

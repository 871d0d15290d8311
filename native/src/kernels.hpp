// The two kernels that take the time of a frame, and the data layouts they work on. Each instruction set has its own
// compiled copy (kernel_unit.cpp); dispatch.hpp chooses one.
#pragma once

#include <cstddef>
#include <cstdint>

#include "bound_garment.hpp"

namespace physkin {

// A layer's outputs are computed in panels of kPanel; within a panel the network weights of one input lie together:
// weights[panel][input][kPanel]. An input is one broadcast, there is no horizontal sum, and memory is read in order.
constexpr int kPanel = 32;

constexpr int padded_to_panel(int count) { return (count + kPanel - 1) / kPanel * kPanel; }

struct PackedLayer {
  int inputs = 0, outputs = 0;
  const float* weights = nullptr;  // (panels, inputs, kPanel), 64-byte aligned, zeros beyond outputs
  const float* bias = nullptr;     // (panels, kPanel)
};

// Vertices in blocks of kBlock that share most of their garment nodes. Skinning weights are dense over the block's
// union of garment nodes, so that every lane does the same work on the same broadcast matrix.
constexpr int kBlock = 16;

struct SkinningBlocks {
  int vertex_count = 0, block_count = 0;
  const std::int32_t* influence_start = nullptr;  // (block_count + 1,) into the next two
  const std::int32_t* influence_node = nullptr;   // (influences,)
  const float* influence_weight = nullptr;        // (influences, kBlock), zeros beyond vertex_count
  const float* rest = nullptr;                    // (block_count, 6, kBlock): x, y, z, normal x, y, z
  const std::int32_t* vertex = nullptr;           // (block_count, kBlock) index in the caller's order
};

// Where vertices go: a row of floats each, x y z or x y z nx ny nz, `stride` floats from row to row. Rows need no
// alignment: a serialised message may place them anywhere.
struct VertexRows {
  unsigned char* data = nullptr;
  std::ptrdiff_t stride = 0;
  bool with_normals = false;
};

struct Kernels {
  const char* instruction_set;

  // output = activation((1 + scale) * (W input + bias) + shift). scale and shift may both be null (no modulation).
  // Writes padded_to_panel(outputs) floats and reads as many of scale and shift; those beyond outputs are unspecified.
  void (*dense)(const PackedLayer& layer, const float* input, const float* scale, const float* shift,
                Activation activation, float* output);

  // x' = sum_k w_k M_k x, normal' = normalised sum_k w_k A_k normal, with M = [A | c] in matrices (nodes, 12).
  void (*skin)(const SkinningBlocks& blocks, const float* matrices, const VertexRows& rows);
};

}  // namespace physkin

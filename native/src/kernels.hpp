// The kernels that take the time of a frame, and the data layouts they work on. Each instruction set has its own
// compiled copy (kernel_unit.cpp); dispatch.hpp chooses one.
#pragma once

#include <cstddef>
#include <cstdint>

#include "bound_garment.hpp"
#include "packed_layer.hpp"

namespace physkin {

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

// Room for what a dense kernel makes of its inputs; the arrays hold a value for each input of the widest layer and
// kGroup more, and are 64-byte aligned.
struct DenseScratch {
  std::int32_t* rows = nullptr;       // rows of network weights to read, when zeros are skipped
  std::int16_t* quantised = nullptr;  // int8: the inputs as 16-bit integers
};

// output = activation((1 + scale) * (W input + bias) + shift). scale and shift may both be null (no modulation).
// input must be 64-byte aligned and readable to a multiple of 64 bytes. Writes padded_to_group(outputs) floats and
// reads as many of scale and shift; those beyond outputs are unspecified.
using DenseKernel = void (*)(const PackedLayer& layer, const float* input, const float* scale, const float* shift,
                             Activation activation, const DenseScratch& scratch, float* output);

struct Kernels {
  const char* instruction_set;
  int panel;  // outputs of a layer computed at once

  DenseKernel dense[kPrecisionCount];           // by Precision
  DenseKernel dense_skipping[kPrecisionCount];  // the same, bit for bit, reading no network weights of zero inputs

  // x' = sum_k w_k M_k x, normal' = normalised sum_k w_k A_k normal, with M = [A | c] in matrices (nodes, 12).
  void (*skin)(const SkinningBlocks& blocks, const float* matrices, const VertexRows& rows);

  // What bounds the others from below (floor_kernel.hpp).
  std::int64_t (*multiply_add)(int rounds, float* result);
  void (*read_memory)(const unsigned char* data, std::int64_t bytes, float* result);
};

}  // namespace physkin

// Linear blend skinning of positions and normals. Included by kernel_unit.cpp only (see simd.hpp).
#pragma once

#include "kernels.hpp"
#include "simd.hpp"

namespace physkin::PHYSKIN_ISA {

// kLanes vertices of a block: sums the matrices of the block's garment nodes, then applies the sum once.
inline void skin_lanes(const float* matrices, const std::int32_t* nodes, int node_count, const float* weights,
                       const float* rest, bool with_normals, float* skinned) {
  Floats blend[12] = {};
  for (int k = 0; k < node_count; ++k) {
    const float* matrix = matrices + 12 * nodes[k];
    const Floats weight = load(weights + k * kBlock);
    for (int e = 0; e < 12; ++e) blend[e] += weight * matrix[e];
  }
  const Floats x = load(rest), y = load(rest + kBlock), z = load(rest + 2 * kBlock);
  for (int r = 0; r < 3; ++r) {
    const Floats* row = blend + 4 * r;
    store(skinned + r * kBlock, row[0] * x + row[1] * y + row[2] * z + row[3]);
  }
  if (!with_normals) return;
  const Floats nx = load(rest + 3 * kBlock), ny = load(rest + 4 * kBlock), nz = load(rest + 5 * kBlock);
  Floats normal[3];
  for (int r = 0; r < 3; ++r) normal[r] = blend[4 * r] * nx + blend[4 * r + 1] * ny + blend[4 * r + 2] * nz;
  const Floats square = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2];
  const Floats inverse = reciprocal_sqrt(at_least(square, 1e-30f));  // a vanished normal stays zero
  for (int r = 0; r < 3; ++r) store(skinned + (3 + r) * kBlock, normal[r] * inverse);
}

template <int kColumns>
inline void write_rows(const float* skinned, const std::int32_t* vertex, int count, const VertexRows& rows) {
  for (int lane = 0; lane < count; ++lane) {
    float row[kColumns];
    for (int c = 0; c < kColumns; ++c) row[c] = skinned[c * kBlock + lane];
    __builtin_memcpy(rows.data + vertex[lane] * rows.stride * std::ptrdiff_t(sizeof(float)), row, sizeof row);
  }
}

inline void skin(const SkinningBlocks& blocks, const float* matrices, const VertexRows& rows) {
  for (int block = 0; block < blocks.block_count; ++block) {
    const std::int32_t start = blocks.influence_start[block];
    const std::int32_t* nodes = blocks.influence_node + start;
    const int node_count = blocks.influence_start[block + 1] - start;
    alignas(64) float skinned[6 * kBlock];
    for (int lane = 0; lane < kBlock; lane += kLanes) {
      skin_lanes(matrices, nodes, node_count, blocks.influence_weight + std::ptrdiff_t(start) * kBlock + lane,
                 blocks.rest + std::ptrdiff_t(block) * 6 * kBlock + lane, rows.with_normals, skinned + lane);
    }
    const std::int32_t* vertex = blocks.vertex + block * kBlock;
    const int left = blocks.vertex_count - block * kBlock;
    const int count = left < kBlock ? left : kBlock;
    if (rows.with_normals) {
      write_rows<6>(skinned, vertex, count, rows);
    } else {
      write_rows<3>(skinned, vertex, count, rows);
    }
  }
}

}  // namespace physkin::PHYSKIN_ISA

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

// Four floats, whatever the width of the registers: rows are put together four vertices at a time.
typedef float Quad __attribute__((vector_size(16), may_alias));

inline void store_floats(unsigned char* target, Quad v, int count) {
  __builtin_memcpy(target, &v, std::size_t(count) * sizeof(float));
}

// Writes vertices `lane` to lane + 3 of a block: the transpose of their columns, in registers.
template <bool kNormals>
inline void write_quad(const float* skinned, const std::int32_t* vertex, int lane, const VertexRows& rows) {
  const auto column = [&](int c) { return *reinterpret_cast<const Quad*>(skinned + c * kBlock + lane); };
  const Quad x = column(0), y = column(1), z = column(2), nx = kNormals ? column(3) : z;
  const Quad xy_low = __builtin_shufflevector(x, y, 0, 4, 1, 5), xy_high = __builtin_shufflevector(x, y, 2, 6, 3, 7);
  const Quad zn_low = __builtin_shufflevector(z, nx, 0, 4, 1, 5), zn_high = __builtin_shufflevector(z, nx, 2, 6, 3, 7);
  const Quad first[4] = {
      __builtin_shufflevector(xy_low, zn_low, 0, 1, 4, 5), __builtin_shufflevector(xy_low, zn_low, 2, 3, 6, 7),
      __builtin_shufflevector(xy_high, zn_high, 0, 1, 4, 5), __builtin_shufflevector(xy_high, zn_high, 2, 3, 6, 7)};
  unsigned char* row[4];
  for (int k = 0; k < 4; ++k) row[k] = rows.data + vertex[lane + k] * rows.stride * std::ptrdiff_t(sizeof(float));
  for (int k = 0; k < 4; ++k) store_floats(row[k], first[k], kNormals ? 4 : 3);
  if (!kNormals) return;
  const Quad ny = column(4), nz = column(5);
  const Quad low = __builtin_shufflevector(ny, nz, 0, 4, 1, 5), high = __builtin_shufflevector(ny, nz, 2, 6, 3, 7);
  constexpr std::ptrdiff_t kRest = 4 * sizeof(float);
  store_floats(row[0] + kRest, low, 2);
  store_floats(row[1] + kRest, __builtin_shufflevector(low, low, 2, 3, 2, 3), 2);
  store_floats(row[2] + kRest, high, 2);
  store_floats(row[3] + kRest, __builtin_shufflevector(high, high, 2, 3, 2, 3), 2);
}

// The garment's last block may be short.
template <int kColumns>
inline void write_some(const float* skinned, const std::int32_t* vertex, int count, const VertexRows& rows) {
  for (int lane = 0; lane < count; ++lane) {
    float row[kColumns];
    for (int c = 0; c < kColumns; ++c) row[c] = skinned[c * kBlock + lane];
    __builtin_memcpy(rows.data + vertex[lane] * rows.stride * std::ptrdiff_t(sizeof(float)), row, sizeof row);
  }
}

template <bool kNormals>
inline void write_rows(const float* skinned, const std::int32_t* vertex, int count, const VertexRows& rows) {
  if (count < kBlock) return write_some<kNormals ? 6 : 3>(skinned, vertex, count, rows);
  for (int lane = 0; lane < kBlock; lane += 4) write_quad<kNormals>(skinned, vertex, lane, rows);
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
      write_rows<true>(skinned, vertex, count, rows);
    } else {
      write_rows<false>(skinned, vertex, count, rows);
    }
  }
}

}  // namespace physkin::PHYSKIN_ISA

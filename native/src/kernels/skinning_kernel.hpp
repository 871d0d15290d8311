// Linear blend skinning of positions and normals. Included by kernel_unit.cpp only (see simd.hpp).
#pragma once

#include "kernels/fours.hpp"
#include "kernels/kernels.hpp"
#include "kernels/simd.hpp"

namespace physkin::PHYSKIN_ISA {

// kLanes skinned vertices, a coordinate each: x y z and, if asked for, nx ny nz.
struct SkinnedLanes {
  Floats column[6];
};

// Registers of vertices whose matrices are summed at once, as many as there are registers for.
#if defined(__aarch64__)
constexpr int kTogether = 2;
#else
constexpr int kTogether = 1;
#endif
constexpr int kLanesTogether = kTogether * kLanes;

// A sum of matrices for each of kTogether registers of vertices.
struct BlendedLanes {
  Floats of[kTogether][12];
};

inline void add_weighted(BlendedLanes* blend, const Floats* weights, const float* matrix) {
#if defined(__aarch64__)  // twelve numbers in three registers: GCC 12 gives each its own
  const float32x4_t row[3] = {vld1q_f32(matrix), vld1q_f32(matrix + 4), vld1q_f32(matrix + 8)};
#pragma GCC unroll 4
  for (int v = 0; v < kTogether; ++v) {
    const float32x4_t weight = (float32x4_t)weights[v];
#pragma GCC unroll 4
    for (int r = 0; r < 3; ++r) {
      Floats* sum = blend->of[v] + 4 * r;
      sum[0] = (Floats)vfmaq_laneq_f32((float32x4_t)sum[0], weight, row[r], 0);
      sum[1] = (Floats)vfmaq_laneq_f32((float32x4_t)sum[1], weight, row[r], 1);
      sum[2] = (Floats)vfmaq_laneq_f32((float32x4_t)sum[2], weight, row[r], 2);
      sum[3] = (Floats)vfmaq_laneq_f32((float32x4_t)sum[3], weight, row[r], 3);
    }
  }
#else
  for (int e = 0; e < 12; ++e) blend->of[0][e] += weights[0] * matrix[e];
#endif
}

// Of the halves of a block that kLanesTogether of its vertices from `lane` on are in.
inline NodeRange nodes_of(const NodeRange* halves, int block, int lane) {
  const NodeRange* of_block = halves + 2 * std::ptrdiff_t(block);
  return {of_block[lane / kHalf].begin, of_block[(lane + kLanesTogether - 1) / kHalf].end};
}

// Calls add(start, weights) for every node of a block, with kLanesTogether weights from `lane` on.
template <class Start, class Weight, class Add>
inline void each_node(const NodeRows<Start, Weight>& rows, int block, int lane, Add add) {
  const NodeRange nodes = nodes_of(rows.halves, block, lane);
  const Weight* weight = rows.weight + std::ptrdiff_t(nodes.begin) * kBlock + lane;
  for (std::int32_t k = nodes.begin; k < nodes.end; ++k, weight += kBlock) {
    Floats weights[kTogether];
#pragma GCC unroll 4
    for (int v = 0; v < kTogether; ++v) weights[v] = widened(weight + v * kLanes);
    add(rows.start[k], weights);
  }
}

// Of a block's garment nodes, for kLanesTogether of its vertices from `lane` on.
inline BlendedLanes blend_lanes(const WideRows& rows, const float* matrices, int block, int lane) {
  BlendedLanes blend = {};
  const auto add = [&](int start, const Floats* weights) { add_weighted(&blend, weights, matrices + start); };
  each_node(rows.influences, block, lane, add);
  return blend;
}

inline BlendedLanes blend_lanes(const NarrowRows& rows, const float* matrices, int block, int lane) {
  BlendedLanes blend = {};
  const auto add = [&](int start, const Floats* weights) { add_weighted(&blend, weights, matrices + start); };
  each_node(rows.heavy_influences, block, lane, add);
  each_node(rows.influences, block, lane, add);
  return blend;
}

// Where they are at rest, moved by the offsets of the block's detail nodes.
struct RestLanes {
  Floats of[kTogether][3];
};

template <bool kDetail, class Rows>
inline RestLanes rest_lanes(const SkinningBlocks& blocks, const Rows& rows, const float* offsets, int block, int lane) {
  RestLanes sum = {};
  if (kDetail) {
    each_node(rows.details, block, lane, [&](int start, const Floats* weights) {
#pragma GCC unroll 4
      for (int v = 0; v < kTogether; ++v) {
        for (int c = 0; c < 3; ++c) sum.of[v][c] += weights[v] * offsets[start + c];
      }
    });
  }
#pragma GCC unroll 4
  for (int v = 0; v < kTogether; ++v) {
    const float* rest = blocks.rest + std::ptrdiff_t(block) * 3 * kBlock + lane + v * kLanes;
    for (int c = 0; c < 3; ++c) {
      const Floats place = load(rest + c * kBlock);
      sum.of[v][c] = kDetail ? place + sum.of[v][c] * blocks.detail_unit : place;
    }
  }
  return sum;
}

// blend: (12), summed matrices of vertices, in `unit`. place: (3), where they are at rest. normal_at_rest: kBlock from a
// coordinate to the next.
template <bool kNormals>
inline SkinnedLanes skin_lanes(const Floats* blend, float unit, const Floats* place, const float* normal_at_rest) {
  const Floats x = place[0] * unit, y = place[1] * unit, z = place[2] * unit;
  SkinnedLanes skinned;
  for (int r = 0; r < 3; ++r) {
    const Floats* row = blend + 4 * r;
    skinned.column[r] = row[0] * x + row[1] * y + row[2] * z + row[3] * unit;
  }
  if (!kNormals) return skinned;
  const Floats nx = load(normal_at_rest) * (unit * unit), ny = load(normal_at_rest + kBlock) * (unit * unit),
               nz = load(normal_at_rest + 2 * kBlock) * (unit * unit);
  Floats normal[3];  // by the cofactors of the linear part, as surfaces turn when they are sheared or stretched
  for (int r = 0; r < 3; ++r) {
    const Floats* p = blend + 4 * ((r + 1) % 3);
    const Floats* q = blend + 4 * ((r + 2) % 3);
    normal[r] = (p[1] * q[2] - p[2] * q[1]) * nx + (p[2] * q[0] - p[0] * q[2]) * ny + (p[0] * q[1] - p[1] * q[0]) * nz;
  }
  const Floats square = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2];
  const Floats inverse = inverse_length(at_least(square, 1e-30f));  // a vanished normal stays zero
  for (int r = 0; r < 3; ++r) skinned.column[3 + r] = normal[r] * inverse;
  return skinned;
}

// Not one copy of 12 bytes: that goes through memory, and waits for it.
inline void store_three(unsigned char* target, Quad v) {
  const float z = v[2];
  __builtin_memcpy(target, &v, 8);
  __builtin_memcpy(target + 8, &z, 4);
}

// Vertices 4 kFour to 4 kFour + 3 of the lanes. first[k]: x y z nx of every fourth from k on. second: ny nz, of the
// even and the odd pair of every four.
template <bool kNormals, int kFour, class Index>
inline void write_four(const Floats* first, const Floats* second, const Index* vertex, const VertexRows& rows,
                       std::ptrdiff_t row_bytes) {
  unsigned char* row[4];
  for (int k = 0; k < 4; ++k) row[k] = rows.data + vertex[4 * kFour + k] * row_bytes;
  if (!kNormals) {
    if (rows.has_fourth) {
      for (int k = 0; k < 4; ++k) {
        const Quad v = four_lanes<kFour>(first[k]);
        __builtin_memcpy(row[k], &v, sizeof v);
      }
    } else {
      for (int k = 0; k < 4; ++k) store_three(row[k], four_lanes<kFour>(first[k]));
    }
    return;
  }
  for (int k = 0; k < 4; ++k) {
    const Quad v = four_lanes<kFour>(first[k]);
    __builtin_memcpy(row[k], &v, sizeof v);
  }
  for (int k = 0; k < 2; ++k) {
    const Quad v = four_lanes<kFour>(second[k]), odd = __builtin_shufflevector(v, v, 2, 3, 2, 3);
    __builtin_memcpy(row[2 * k] + sizeof v, &v, 8);
    __builtin_memcpy(row[2 * k + 1] + sizeof v, &odd, 8);
  }
}

// Writes kLanes vertices: the transpose of their columns, in registers.
template <bool kNormals, class Index>
inline void write_rows(const SkinnedLanes& skinned, const Index* vertex, const VertexRows& rows,
                       std::ptrdiff_t row_bytes) {
  const Floats* c = skinned.column;
  const Floats& fourth = kNormals ? c[3] : c[2];
  const Floats xy_low = zip_low(c[0], c[1]), xy_high = zip_high(c[0], c[1]);
  const Floats zn_low = zip_low(c[2], fourth), zn_high = zip_high(c[2], fourth);
  const Floats first[4] = {halves_low(xy_low, zn_low), halves_high(xy_low, zn_low), halves_low(xy_high, zn_high),
                           halves_high(xy_high, zn_high)};
  Floats second[2] = {};
  if (kNormals) second[0] = zip_low(c[4], c[5]), second[1] = zip_high(c[4], c[5]);
  write_four<kNormals, 0>(first, second, vertex, rows, row_bytes);
#if defined(__AVX2__)
  write_four<kNormals, 1>(first, second, vertex, rows, row_bytes);
#endif
#if defined(__AVX512F__)
  write_four<kNormals, 2>(first, second, vertex, rows, row_bytes);
  write_four<kNormals, 3>(first, second, vertex, rows, row_bytes);
#endif
}

// Up to kLanes vertices, of the garment's last block.
template <bool kNormals, class Index>
inline void write_some(const SkinnedLanes& skinned, const Index* vertex, int count, const VertexRows& rows,
                       std::ptrdiff_t row_bytes) {
  for (int lane = 0; lane < count && lane < kLanes; ++lane) {
    float row[kNormals ? 6 : 3];
    for (int c = 0; c < (kNormals ? 6 : 3); ++c) row[c] = skinned.column[c][lane];
    __builtin_memcpy(rows.data + vertex[lane] * row_bytes, row, sizeof row);
  }
}

// The block that may be short comes after the loop: within, choosing between two ways to write would put the columns
// into memory for the one that is not taken.
template <bool kNormals, bool kDetail, class Rows>
inline void skin_blocks(const SkinningBlocks& blocks, const Rows& nodes, const float* matrices, const float* offsets,
                        const VertexRows& rows) {
  const std::ptrdiff_t row_bytes = rows.stride * std::ptrdiff_t(sizeof(float));
  const int full = blocks.vertex_count / kBlock, left = blocks.vertex_count % kBlock;
  const auto* vertex = nodes.vertex;
  const float* normals = blocks.normals;
  for (int block = 0; block < full; ++block, normals += 3 * kBlock) {
    for (int lane = 0; lane < kBlock; lane += kLanesTogether) {
      const RestLanes rest = rest_lanes<kDetail>(blocks, nodes, offsets, block, lane);
      const BlendedLanes blend = blend_lanes(nodes, matrices, block, lane);
#pragma GCC unroll 4
      for (int v = 0; v < kTogether; ++v, vertex += kLanes) {
        write_rows<kNormals>(skin_lanes<kNormals>(blend.of[v], blocks.unit, rest.of[v], normals + lane + v * kLanes),
                             vertex, rows, row_bytes);
      }
    }
  }
  for (int lane = 0; lane < left; lane += kLanesTogether) {
    const RestLanes rest = rest_lanes<kDetail>(blocks, nodes, offsets, full, lane);
    const BlendedLanes blend = blend_lanes(nodes, matrices, full, lane);
#pragma GCC unroll 4
    for (int v = 0; v < kTogether; ++v, vertex += kLanes) {
      const int from = lane + v * kLanes;
      write_some<kNormals>(skin_lanes<kNormals>(blend.of[v], blocks.unit, rest.of[v], normals + from), vertex,
                           left - from, rows, row_bytes);
    }
  }
}

template <class Rows>
inline void skin_nodes(const SkinningBlocks& blocks, const Rows& nodes, const float* matrices, const float* offsets,
                       const VertexRows& rows) {
  if (offsets != nullptr) {
    rows.with_normals ? skin_blocks<true, true>(blocks, nodes, matrices, offsets, rows)
                      : skin_blocks<false, true>(blocks, nodes, matrices, offsets, rows);
  } else {
    rows.with_normals ? skin_blocks<true, false>(blocks, nodes, matrices, nullptr, rows)
                      : skin_blocks<false, false>(blocks, nodes, matrices, nullptr, rows);
  }
}

inline void skin(const SkinningBlocks& blocks, const float* matrices, const float* offsets, const VertexRows& rows) {
  blocks.is_narrow ? skin_nodes(blocks, blocks.narrow, matrices, offsets, rows)
                   : skin_nodes(blocks, blocks.wide, matrices, offsets, rows);
}

}  // namespace physkin::PHYSKIN_ISA

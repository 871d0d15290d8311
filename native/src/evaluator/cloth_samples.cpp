#include "evaluator/cloth_samples.hpp"

#include <algorithm>

#include "evaluator/skin_part.hpp"

namespace physkin {
namespace {

SkinningData as_vertices(const BoundGarment& g, const ClothSampling& of) {
  SkinningData data;
  data.nodes = g.nodes;
  data.vertex_count = of.samples;
  data.influences = of.influences;
  data.node_rest = g.node_rest;
  data.vertices = of.vertices;
  data.normals = of.vertices;  // nobody asks for them
  data.influence_nodes = of.influence_nodes;
  data.influence_weights = of.influence_weights;
  data.detail_vertices = of.detail_influences > 0 ? of.samples : 0;
  data.detail_influences = of.detail_influences;
  data.detail_numbers = g.detail_numbers;
  data.detail_nodes = of.detail_nodes;
  data.detail_weights = of.detail_weights;
  return data;
}

// Views of each block by itself.
std::vector<SkinningBlocks> one_by_one(const SkinningBlocks& all) {
  std::vector<SkinningBlocks> blocks;
  for (int block = 0; block < all.block_count; ++block) {
    SkinningBlocks& one = blocks.emplace_back(all);
    one.vertex_count = std::min(all.vertex_count - block * kBlock, kBlock);
    one.block_count = 1;
    one.influences += 2 * std::ptrdiff_t(block);
    one.rest += std::ptrdiff_t(block) * 6 * kBlock;
    one.vertex += std::ptrdiff_t(block) * kBlock;
    if (one.details != nullptr) one.details += 2 * std::ptrdiff_t(block);
  }
  return blocks;
}

}  // namespace

ClothSamples::ClothSamples(const BoundGarment& g, const ClothSampling& of, const Kernels& kernels, Arena& arena)
    : kernels_(kernels),
      count_(of.samples),
      rows_(padded_to_points(count_)),
      blocks_(one_by_one(pack_skinning_blocks(as_vertices(g, of), arena))),
      skinned_(arena.take<float>(3 * std::size_t(count_))),
      positions_(arena.take<float>(3 * std::size_t(rows_))) {}

void ClothSamples::place(int block, const float* matrices, const float* offsets) noexcept {
  const SkinningBlocks& one = blocks_[block];
  kernels_.skin(one, matrices, offsets, {reinterpret_cast<unsigned char*>(skinned_), 3, false});
  for (int lane = 0; lane < one.vertex_count; ++lane) {
    const std::ptrdiff_t s = one.vertex[lane];
    for (int axis = 0; axis < 3; ++axis) positions_[axis * rows_ + s] = skinned_[3 * s + axis];
  }
}

}  // namespace physkin

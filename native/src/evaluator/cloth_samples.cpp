#include "evaluator/cloth_samples.hpp"

#include "evaluator/skin_part.hpp"

namespace physkin {
namespace {

static_assert(kBlock % kTrunkPoints == 0, "positions are looked up in whole calls of the kernels");

SkinningData as_vertices(const BoundGarment& g, const ClothSampling& of) {
  SkinningData data;
  data.nodes = g.nodes;
  data.vertex_count = of.samples;
  data.influences = of.influences;
  data.node_rest = g.node_rest;
  data.vertices = of.vertices;
  data.influence_nodes = of.influence_nodes;
  data.influence_weights = of.influence_weights;
  data.detail_vertices = of.detail_influences > 0 ? of.samples : 0;
  data.detail_influences = of.detail_influences;
  data.detail_numbers = g.detail_numbers;
  data.detail_nodes = of.detail_nodes;
  data.detail_weights = of.detail_weights;
  return data;
}

}  // namespace

ClothSamples::ClothSamples(const BoundGarment& g, const ClothSampling& of, const Kernels& kernels, Arena& arena)
    : kernels_(kernels),
      blocks_(pack_skinning_blocks(as_vertices(g, of), arena)),
      is_at_rest_(arena.take<bool>(std::size_t(blocks()))),
      at_rest_(arena.take<float>(3 * std::size_t(rows()))) {}

void ClothSamples::begin(const float* offsets) noexcept {
  offsets_ = offsets;
  std::fill_n(is_at_rest_, blocks(), false);
}

void ClothSamples::place(int block, const float* matrices, float* positions) noexcept {
  float* at_rest = at_rest_ + 3 * std::ptrdiff_t(kBlock) * block;
  if (!is_at_rest_[block]) kernels_.rest(blocks_, block, offsets_, at_rest);
  is_at_rest_[block] = true;
  kernels_.place(blocks_, block, matrices, at_rest, positions + std::ptrdiff_t(kBlock) * block, rows());
}

}  // namespace physkin

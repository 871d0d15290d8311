#include "evaluator/skinner.hpp"

#include "evaluator/affine.hpp"

namespace physkin {

Skinner::Skinner(const SkinningData& data, const Kernels& kernels, Arena& arena)
    : kernels_(kernels),
      nodes_(data.nodes),
      blocks_(pack_skinning_blocks(data, arena)),
      node_rest_(arena.copy(data.node_rest, 3 * std::size_t(data.nodes))),
      matrices_(arena.take<float>(12 * std::size_t(data.nodes))) {}

Rejection Skinner::check(const float* node_transforms) const noexcept {
  return reject_beyond("node_transforms", node_transforms, 12 * std::size_t(nodes_), kLargest);
}

void Skinner::skin(const float* node_transforms, const VertexRows& rows) noexcept {
  for (int i = 0; i < nodes_; ++i) {
    const Affine node = load_affine(node_transforms + 12 * i);
    store_affine({node.linear, node.translation - node.linear * load_vector(node_rest_ + 3 * i)}, matrices_ + 12 * i);
  }
  kernels_.skin(blocks_, matrices_, rows);
}

}  // namespace physkin

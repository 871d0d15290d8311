#include "evaluator/skinner.hpp"

#include <vector>

#include "evaluator/affine.hpp"

namespace physkin {

Skinner::Skinner(const SkinningData& data, Precision precision, const Kernels& kernels, Arena& arena)
    : kernels_(kernels),
      nodes_(data.nodes),
      features_(data.has_detail() ? data.detail_features : 0),
      blocks_(pack_skinning_blocks(data, arena)),
      node_rest_(arena.copy(data.node_rest, 3 * std::size_t(data.nodes))),
      matrices_(arena.take<float>(12 * std::size_t(data.nodes))) {
  if (!data.has_detail()) return;
  const std::vector<float> no_bias(std::size_t(data.detail_numbers));
  const DenseWeights offsets{data.detail_numbers, data.detail_features, data.detail_offsets, no_bias.data()};
  detail_offsets_.emplace(std::vector<DenseWeights>{offsets}, precision, precision, kernels, arena);
}

Rejection Skinner::check(const float* node_transforms) const noexcept {
  return reject_beyond("node_transforms", node_transforms, 12 * std::size_t(nodes_), kLargest);
}

Rejection Skinner::check_features(const float* features) const noexcept {
  return reject_beyond("features", features, std::size_t(features_), kLargest);
}

void Skinner::skin(const float* node_transforms, const float* features, const VertexRows& rows) noexcept {
  for (int i = 0; i < nodes_; ++i) {
    const Affine node = load_affine(node_transforms + 12 * i);
    store_affine({node.linear, node.translation - node.linear * load_vector(node_rest_ + 3 * i)}, matrices_ + 12 * i);
  }
  kernels_.skin(blocks_, matrices_, detail_offsets_ ? detail_offsets_->run(features, nullptr) : nullptr, rows);
}

}  // namespace physkin

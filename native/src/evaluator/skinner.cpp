#include "evaluator/skinner.hpp"

#include "evaluator/affine.hpp"

namespace physkin {

void skinning_matrices(const float* node_transforms, const float* node_rest, int nodes, float* matrices) noexcept {
  for (int i = 0; i < nodes; ++i) {
    const Affine node = load_affine(node_transforms + 12 * i);
    store_affine({node.linear, node.translation - node.linear * load_vector(node_rest + 3 * i)}, matrices + 12 * i);
  }
}

Skinner::Skinner(const SkinningData& data, const Kernels& kernels, Arena& arena)
    : kernels_(kernels),
      nodes_(data.nodes),
      detail_nodes_(data.has_detail() ? data.detail_numbers / 3 : 0),
      blocks_(pack_skinning_blocks(data, arena)),
      node_rest_(arena.copy(data.node_rest, 3 * std::size_t(data.nodes))),
      matrices_(arena.take<float>(12 * std::size_t(data.nodes))) {
  if (data.face_count > 0) {
    const std::size_t before = arena.touched(), lanes = std::size_t(blocks_.block_count) * kBlock;
    face_normals_.emplace(data, kernels, arena);
    normals_bytes_ = arena.touched() - before;
    blocks_into_places_ = blocks_;
    const auto into_places = [&](auto& rows) {
      auto* places = arena.copy(rows.vertex, lanes);
      for (int i = 0; i < data.vertex_count; ++i) places[i] = face_normals_->place_of(rows.vertex[i]);
      rows.vertex = places;
      return lanes * sizeof(*places);
    };
    const std::size_t of_order =
        blocks_.is_narrow ? into_places(blocks_into_places_.narrow) : into_places(blocks_into_places_.wide);
    // Only a frame in which others move vertices reads the order and normals of blocks_.
    arena.leave_out(of_order + lanes * 3 * sizeof(float));
  }
}

Rejection Skinner::check(const float* node_transforms) const noexcept {
  return reject_beyond("node_transforms", node_transforms, 12 * std::size_t(nodes_), kLargest);
}

Rejection Skinner::check_offsets(const float* offsets) const noexcept {
  return reject_beyond("detail_offsets", offsets, 3 * std::size_t(detail_nodes_), kLargest);
}

void Skinner::skin(const float* node_transforms, const float* offsets, const VertexRows& rows,
                   bool are_moved) noexcept {
  skinning_matrices(node_transforms, node_rest_, nodes_, matrices_);
  const bool into_places = face_normals_ && rows.with_normals && !are_moved;
  kernels_.skin(into_places ? blocks_into_places_ : blocks_, matrices_, detail_nodes_ > 0 ? offsets : nullptr,
                into_places ? face_normals_->places() : rows);
}

void Skinner::compute_normals(const VertexRows& rows, bool were_moved) noexcept {
  if (!face_normals_ || !rows.with_normals) return;
  if (were_moved) face_normals_->place(rows);
  face_normals_->write(rows);
}

}  // namespace physkin

// Linear blend skinning of one garment from its garment nodes' transforms, and its normals.
#pragma once

#include <optional>

#include "evaluator/face_normals.hpp"
#include "garment/bound_garment.hpp"
#include "garment/finite.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

// Packs a garment's vertices for the kernel (skinning_blocks.cpp): in blocks that go with few nodes, or, where others count
// on their order, as they are given. In narrow rows where nothing is lost: where garment nodes' weights are whole 1/4095
// and detail nodes' whole 1/511, as model files hold them.
enum class BlockOrder { kFewNodes, kAsGiven };
SkinningBlocks pack_skinning_blocks(const SkinningData& data, Arena& arena, BlockOrder order = BlockOrder::kFewNodes);

// chi_i * inverse of each garment node's rest transform, what the kernel takes. All (nodes, 3, 4), node_rest (nodes, 3).
void skinning_matrices(const float* node_transforms, const float* node_rest, int nodes, float* matrices) noexcept;

// Normals are those of the posed mesh's faces, weighted by area: rest normals know nothing of ripples and folds. Where
// there are no faces, as of points, skinning carries rest normals along.
class Skinner {
 public:
  // The data must be valid; they are copied into the arena.
  Skinner(const SkinningData& data, const Kernels& kernels, Arena& arena);

  // node_transforms (nodes, 3, 4), root frame, metres: refused where they are not finite.
  Rejection check(const float* node_transforms) const noexcept;

  // Offsets of detail nodes (detail_nodes, 3), at rest, metres: refused likewise.
  Rejection check_offsets(const float* offsets) const noexcept;

  // From transforms and offsets that were checked; these are not read without detail. Both write the rows, and allocate
  // nothing; compute_normals has nothing to do where normals are carried along. are_moved: in between somebody moves vertices, by
  // normals that are carried along first.
  void skin(const float* node_transforms, const float* offsets, const VertexRows& rows,
            bool are_moved = false) noexcept;
  void compute_normals(const VertexRows& rows, bool were_moved = false) noexcept;

  int nodes() const { return nodes_; }
  int detail_nodes() const { return detail_nodes_; }  // 0 without detail
  int vertex_count() const { return blocks_.vertex_count; }
  bool has_face_normals() const { return face_normals_.has_value(); }
  // Of the arena, bytes that `compute_normals` touches.
  std::size_t normals_bytes() const { return normals_bytes_; }

 private:
  const Kernels& kernels_;
  int nodes_, detail_nodes_;
  SkinningBlocks blocks_;
  std::optional<FaceNormals> face_normals_;
  SkinningBlocks blocks_into_places_;  // the same, with vertices in the order of these normals' places
  const float* node_rest_;             // (nodes, 3)
  std::size_t normals_bytes_ = 0;
  float* matrices_;  // (nodes, 3, 4): chi_i * inverse of the node's rest transform
};

}  // namespace physkin

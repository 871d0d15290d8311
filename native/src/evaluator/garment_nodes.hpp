// Posing the garment nodes and composing them with the node deformer's corrections.
#pragma once

#include "evaluator/affine.hpp"
#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"

namespace physkin {

class GarmentNodes {
 public:
  GarmentNodes(const BoundGarment& garment, Arena& arena);

  // From bone_transforms (bones, 3, 4) and the node deformer's output (nodes, 12), in metres, root frame:
  // transforms (nodes, 3, 4), chi_i = [R_b | R_b q_i + t_b] * Delta_i with b the bone that garment node i follows.
  void compose(const float* bone_transforms, const float* corrections, float* transforms) const;

  // What `compose` makes of a garment node by corrections, less what it makes of it by others (nodes, 12).
  Affine added(int node, const float* bone_transforms, const float* corrections, const float* others) const;

  int bone(int node) const { return bone_[node]; }
  Vector3 position(int node) const { return load_vector(positions_ + 3 * node); }  // at rest, in its bone
  int count() const { return count_; }

 private:
  int count_;
  const std::int32_t* bone_;
  const float* positions_;
};

}  // namespace physkin

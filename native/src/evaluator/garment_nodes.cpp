#include "evaluator/garment_nodes.hpp"

#include "evaluator/affine.hpp"

namespace physkin {
namespace {

// 12 numbers: the difference of the linear part from identity, row-major, then the translation.
Affine decode_affine(const float* c) {
  return {{{load_vector(c) + kIdentity3.rows[0], load_vector(c + 3) + kIdentity3.rows[1],
            load_vector(c + 6) + kIdentity3.rows[2]}},
          load_vector(c + 9)};
}

}  // namespace

GarmentNodes::GarmentNodes(const BoundGarment& g, Arena& arena)
    : count_(g.nodes), bone_(arena.copy(g.node_bone, g.nodes)), positions_(arena.copy(g.node_positions, 3 * g.nodes)) {}

void GarmentNodes::compose(const float* bone_transforms, const float* corrections, float* transforms) const {
  for (int i = 0; i < count_; ++i, corrections += 12) {
    const Affine bone = load_affine(bone_transforms + 12 * bone_[i]);
    const Affine delta = decode_affine(corrections);
    // R_b q + t_b is the posed node; the correction's translation is in the posed node's own frame.
    const Vector3 moved = load_vector(positions_ + 3 * i) + delta.translation;
    store_affine({bone.linear * delta.linear, bone.linear * moved + bone.translation}, transforms + 12 * i);
  }
}

Affine GarmentNodes::added(int node, const float* bone_transforms, const float* corrections,
                           const float* others) const {
  const Matrix3 bone = load_affine(bone_transforms + 12 * bone_[node]).linear;
  float apart[12];
  for (int k = 0; k < 12; ++k) apart[k] = corrections[12 * node + k] - others[12 * node + k];
  const Matrix3 linear{{load_vector(apart), load_vector(apart + 3), load_vector(apart + 6)}};
  return {bone * linear, bone * load_vector(apart + 9)};
}

}  // namespace physkin

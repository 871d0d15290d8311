#include "evaluator/garment_nodes.hpp"

#include "evaluator/affine.hpp"

namespace physkin {
namespace {

// 9 numbers (a, b, t): the rotation whose first two columns are e1 + a and e2 + b orthonormalised (Gram-Schmidt).
Affine decode_rotation(const float* c) {
  const Vector3 first = normalized(Vector3{1.0f + c[0], c[1], c[2]});
  const Vector3 raw{c[3], 1.0f + c[4], c[5]};
  const Vector3 second = normalized(raw - dot(first, raw) * first);
  return {from_columns(first, second, cross(first, second)), load_vector(c + 6)};
}

// 12 numbers: the difference of the linear part from identity, row-major, then the translation.
Affine decode_affine(const float* c) {
  return {{{load_vector(c) + kIdentity3.rows[0], load_vector(c + 3) + kIdentity3.rows[1],
            load_vector(c + 6) + kIdentity3.rows[2]}},
          load_vector(c + 9)};
}

}  // namespace

GarmentNodes::GarmentNodes(const BoundGarment& g, Arena& arena)
    : count_(g.nodes),
      correction_size_(g.deformer_layers.back().outputs / g.nodes),
      bone_(arena.copy(g.node_bone, g.nodes)),
      positions_(arena.copy(g.node_positions, 3 * g.nodes)) {}

void GarmentNodes::compose(const float* bone_transforms, const float* corrections, float* transforms) const {
  for (int i = 0; i < count_; ++i, corrections += correction_size_) {
    const Affine bone = load_affine(bone_transforms + 12 * bone_[i]);
    const Affine delta = correction_size_ == 9 ? decode_rotation(corrections) : decode_affine(corrections);
    // R_b q + t_b is the posed node; the correction's translation is in the posed node's own frame.
    const Vector3 moved = load_vector(positions_ + 3 * i) + delta.translation;
    store_affine({bone.linear * delta.linear, bone.linear * moved + bone.translation}, transforms + 12 * i);
  }
}

}  // namespace physkin

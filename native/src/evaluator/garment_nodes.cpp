#include "evaluator/garment_nodes.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "evaluator/affine.hpp"

namespace physkin {
namespace {

// A thigh this upright (cosine) holds all twist back, as cloth lies on it, and one as upright as the second none.
constexpr float kLiesOn = 0.6f, kHangs = 0.9f;

// 12 numbers: the difference of the linear part from identity, row-major, then the translation.
Affine decode_affine(const float* c) {
  return {{{load_vector(c) + kIdentity3.rows[0], load_vector(c + 3) + kIdentity3.rows[1],
            load_vector(c + 6) + kIdentity3.rows[2]}},
          load_vector(c + 9)};
}

}  // namespace

GarmentNodes::GarmentNodes(const BoundGarment& g, Arena& arena)
    : count_(g.nodes),
      bone_(arena.copy(g.node_bone, g.nodes)),
      positions_(arena.copy(g.node_positions, 3 * g.nodes)),
      shares_(g.twist_size > 0 ? arena.copy(g.node_twist, g.nodes) : nullptr),
      shares_total_(std::accumulate(g.node_twist, g.node_twist + std::max(g.twist_size, 0), 0.0f)) {}

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

void GarmentNodes::twist(const float* bone_transforms, float twist, float* transforms) const {
  if (twist == 0 || !(shares_total_ > 0)) return;
  float upright = 0, least = 1;
  for (int i = 0; i < count_; ++i) {
    const float own = bone_transforms[12 * bone_[i] + 10];
    upright += shares_[i] * own;
    if (shares_[i] > 0 && shares_[i] < 1) least = std::min(least, own);  // by the thighs: below, cloth twists in full
  }
  const float hangs = std::clamp((least - kLiesOn) / (kHangs - kLiesOn), 0.0f, 1.0f);
  twist *= std::max(upright / shares_total_, 0.0f) * hangs * hangs * (3 - 2 * hangs);
  for (int i = 0; i < count_; ++i, transforms += 12) {
    if (shares_[i] == 0) continue;
    const float angle = shares_[i] * twist, cosine = std::cos(angle), sine = std::sin(angle);
    for (int k = 0; k < 4; ++k) {
      const float x = transforms[k], y = transforms[k + 4];
      transforms[k] = cosine * x - sine * y;
      transforms[k + 4] = sine * x + cosine * y;
    }
    transforms[11] += kTwistLift * twist * angle;
  }
}

}  // namespace physkin

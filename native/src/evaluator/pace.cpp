#include "evaluator/pace.hpp"

#include <algorithm>
#include <cmath>

namespace physkin {
namespace {

float length(Vector3 a) { return std::sqrt(dot(a, a)); }

Matrix3 transposed(const Matrix3& m) { return from_columns(m.rows[0], m.rows[1], m.rows[2]); }

// a + share (b - a)
Vector3 between(Vector3 a, Vector3 b, float share) { return a + share * (b - a); }

float distance(const Matrix3& a, const Matrix3& b) {
  float square = 0;
  for (int i = 0; i < 3; ++i) {
    const Vector3 apart = a.rows[i] - b.rows[i];
    square += dot(apart, apart);
  }
  return std::sqrt(square);
}

}  // namespace

Pace::Pace(int nodes, int detail_nodes, Arena& arena)
    : detail_nodes_(detail_nodes),
      last_(arena.take<Last>(std::size_t(nodes))),
      offsets_(arena.take<float>(3 * std::size_t(detail_nodes))) {}

void Pace::keep(const GarmentNodes& nodes, const float* bone_transforms, float passed, float* transforms,
                const float* offsets) noexcept {
  const bool counts = any_ && passed >= 0;
  keep_garment_nodes(nodes, bone_transforms, counts, kPace * passed, transforms);
  keep_detail_nodes(offsets, counts, kPace * passed);
  any_ = true;
}

void Pace::keep_garment_nodes(const GarmentNodes& nodes, const float* bone_transforms, bool counts, float allowed,
                              float* transforms) noexcept {
  for (int i = 0; i < nodes.count(); ++i, transforms += 12) {
    const Affine bone = load_affine(bone_transforms + 12 * nodes.bone(i));
    Affine now = load_affine(transforms);
    Matrix3 linear = transposed(bone.linear) * now.linear;
    const Vector3 carried = bone.linear * nodes.position(i) + bone.translation;
    Last& last = last_[i];
    if (counts) {
      const float moved = length(now.translation - last.position), turned = kReach * distance(linear, last.linear);
      const float free = length(carried - last.carried) + allowed;
      if (moved > free || turned > allowed) {
        if (moved > free) now.translation = between(last.position, now.translation, free / moved);
        if (turned > allowed) {
          for (int k = 0; k < 3; ++k) linear.rows[k] = between(last.linear.rows[k], linear.rows[k], allowed / turned);
          now.linear = bone.linear * linear;
        }
        store_affine(now, transforms);
      }
    }
    last = {linear, now.translation, carried};
  }
}

void Pace::keep_detail_nodes(const float* offsets, bool counts, float allowed) noexcept {
  const int numbers = 3 * detail_nodes_;
  bool may_be_fast = false;
  if (counts) {
    const float least = allowed / std::sqrt(3.0f);  // nearly always no number differs by as much
    for (int k = 0; k < numbers; ++k) may_be_fast |= std::fabs(offsets[k] - offsets_[k]) > least;
  }
  if (!may_be_fast) {
    std::copy_n(offsets, numbers, offsets_);
    return;
  }
  for (int node = 0; node < detail_nodes_; ++node) {
    float* last = offsets_ + 3 * node;
    const Vector3 from = load_vector(last), wanted = load_vector(offsets + 3 * node), step = wanted - from;
    const float square = dot(step, step);
    const bool is_fast = square > allowed * allowed;
    const Vector3 now = is_fast ? between(from, wanted, allowed / std::sqrt(square)) : wanted;
    last[0] = now.x;
    last[1] = now.y;
    last[2] = now.z;
  }
}

}  // namespace physkin

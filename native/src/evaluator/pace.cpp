#include "evaluator/pace.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>

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

Pace::Pace(int nodes, Arena& arena) : last_(arena.take<Last>(std::size_t(nodes))) {}

void Pace::keep(const GarmentNodes& nodes, const float* bone_transforms, float passed, float* transforms) noexcept {
  const bool counts = any_ && passed >= 0;
  const float allowed = kPace * passed;
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
  any_ = true;
}

FeaturePace::FeaturePace(const SkinningData& d, Arena& arena)
    : features_(d.detail_features),
      detail_nodes_(d.detail_numbers / 3),
      step_(arena.take<float>(padded_to_group(d.detail_features) + kGroup)) {
  float largest = 0;
  for (int node = 0; node < detail_nodes_; ++node) {
    const float* rows = d.detail_offsets + 3 * std::ptrdiff_t(node) * features_;
    largest = std::max(largest, std::inner_product(rows, rows + 3 * features_, rows, 0.0f));
  }
  farthest_ = std::sqrt(largest);
}

void FeaturePace::keep(Skinner& skinner, const float* wanted, float passed, float* features) noexcept {
  const float allowed = kPace * passed;
  float share = 1;
  if (any_ && passed >= 0) {
    std::transform(wanted, wanted + features_, features, step_, std::minus<>());
    // Nearly always their size tells that no node is too fast.
    if (farthest_ * std::sqrt(std::inner_product(step_, step_ + features_, step_, 0.0f)) > allowed) {
      const float* offsets = skinner.detail_offsets(step_);
      float fastest = 0;
      for (int node = 0; node < detail_nodes_; ++node) {
        fastest = std::max(fastest, length(load_vector(offsets + 3 * std::ptrdiff_t(node))));
      }
      if (fastest > allowed) share = allowed / fastest;
    }
  }
  if (share < 1) {
    for (int k = 0; k < features_; ++k) features[k] += share * step_[k];
  } else {
    std::copy_n(wanted, features_, features);
  }
  any_ = true;
}

}  // namespace physkin

// The pace of cloth: between two frames garment nodes go no farther than their bones carry them, and a little more.
//
// Where cloth can lie in two places, networks switch from one to the other within a few degrees of a joint: cloth leaps
// by a hand's breadth from one frame to the next. Where frames have time stamps, it goes over in some frames instead.
#pragma once

#include "evaluator/affine.hpp"
#include "evaluator/garment_nodes.hpp"
#include "evaluator/skinner.hpp"
#include "kernels/arena.hpp"

namespace physkin {

// [m/s] by which a garment node, and cloth beside it, may be faster than its bone; and [m] how far beside a garment
// node cloth lies that it carries.
constexpr float kPace = 2.0f, kReach = 0.1f;

class Pace {
 public:
  Pace(int nodes, Arena& arena);

  // Where transforms (nodes, 3, 4) have leapt since the last frame, `passed` [s] ago, they are brought back on the way.
  // Negative: what was before does not count. bone_transforms (bones, 3, 4) are those the nodes were composed with.
  void keep(const GarmentNodes& nodes, const float* bone_transforms, float passed, float* transforms) noexcept;

  // The last frame does not count.
  void forget() noexcept { any_ = false; }

 private:
  struct Last {
    Matrix3 linear;             // in the frame of the garment node's bone
    Vector3 position, carried;  // where it was, and where its bone alone had put it
  };

  Last* last_;
  bool any_ = false;
};

// The same of detail nodes, which move with the features of a frame: all of these go as far as the fastest node may, so
// that offsets remain those of the features that are shown.
class FeaturePace {
 public:
  FeaturePace(const SkinningData& data, Arena& arena);

  // Moves features (data.detail_features), those of the last frame, towards `wanted`; skinner: of the same data.
  void keep(Skinner& skinner, const float* wanted, float passed, float* features) noexcept;

  void forget() noexcept { any_ = false; }

 private:
  int features_, detail_nodes_;
  float farthest_;  // [m] that a detail node may go for features that differ by 1 in all
  float* step_;     // (features_,) from the last features to the wanted ones
  bool any_ = false;
};

}  // namespace physkin

// The pace of cloth: between two frames garment nodes go little farther than their bones carry them, and so do detail nodes
// in the garment at rest.
//
// Where cloth can lie in two places, networks switch from one to the other within a few degrees of a joint: cloth leaps
// by a hand's breadth from one frame to the next. Where frames have time stamps, it goes over in some frames instead.
#pragma once

#include "evaluator/affine.hpp"
#include "evaluator/garment_nodes.hpp"
#include "kernels/arena.hpp"

namespace physkin {

// [m/s] by which a garment node, and cloth beside it, may be faster than its bone, and a detail node at rest; and [m] how far beside a garment node cloth lies that it carries.
constexpr float kPace = 2.0f, kReach = 0.1f;

class Pace {
 public:
  Pace(int nodes, int detail_nodes, Arena& arena);

  // Where transforms (nodes, 3, 4), or offsets of detail nodes (detail nodes, 3), have leapt since the last frame,
  // `passed` [s] ago, they are brought back on the way: transforms in place. Negative: what was before does not count.
  // bone_transforms (bones, 3, 4) are those the nodes were composed with. offsets: not read without detail.
  void keep(const GarmentNodes& nodes, const float* bone_transforms, float passed, float* transforms,
            const float* offsets) noexcept;

  // Those of the last frame, so far as they were let go; zeros before the first one, null without detail.
  const float* offsets() const { return detail_nodes_ > 0 ? offsets_ : nullptr; }

  // The last frame does not count.
  void forget() noexcept { any_ = false; }

 private:
  struct Last {
    Matrix3 linear;             // in the frame of the garment node's bone
    Vector3 position, carried;  // where it was, and where its bone alone had put it
  };

  // counts: whether the last frame does. allowed [m]: by pace.
  void keep_garment_nodes(const GarmentNodes& nodes, const float* bone_transforms, bool counts, float allowed,
                          float* transforms) noexcept;
  void keep_detail_nodes(const float* offsets, bool counts, float allowed) noexcept;

  int detail_nodes_;
  Last* last_;
  float* offsets_;  // (detail nodes, 3) [m]
  bool any_ = false;
};

}  // namespace physkin

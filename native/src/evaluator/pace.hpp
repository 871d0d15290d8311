// The pace of cloth: between two frames garment nodes go no farther than their bones carry them, and a little more.
//
// Where cloth can lie in two places, networks switch from one to the other within a few degrees of a joint: cloth leaps
// by a hand's breadth from one frame to the next. Where frames have time stamps, it goes over in some frames instead.
#pragma once

#include "evaluator/affine.hpp"
#include "evaluator/garment_nodes.hpp"
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

}  // namespace physkin

// Keeps garment nodes from leaping from one frame to the next; physkin_core/sway/pace.py is its readable twin.
#pragma once

#include "evaluator/affine.hpp"
#include "evaluator/garment_nodes.hpp"
#include "kernels/arena.hpp"

namespace physkin {

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

// From joint positions to bone transforms and the pose vector.
#pragma once

#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"

namespace physkin {

class Rig {
 public:
  Rig(const BoundGarment& garment, Arena& arena);

  // transforms (bones, 3, 4): [R | t] from the canonical pose to the posed one, root frame.
  void compute_bone_transforms(const float* joint_positions, float* transforms) const;

  // pose (dofs + 3): joint positions scaled to [-1, 1] by their limits and clipped, then the gravity direction.
  void compute_pose_vector(const float* joint_positions, const float* gravity, float* pose) const;

  int dofs() const { return dofs_; }

 private:
  int bones_, dofs_;
  const std::int32_t* parents_;
  const float* heads_;
  const std::int32_t* dof_start_;  // (bones + 1) into dof_order_
  const std::int32_t* dof_order_;  // degrees of freedom by bone, in listed order within a bone
  const float* axis_;
  const float* rest_;
  const float* lower_;
  const float* upper_;
};

}  // namespace physkin

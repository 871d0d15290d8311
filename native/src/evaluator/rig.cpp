#include "evaluator/rig.hpp"

#include <algorithm>
#include <cmath>

#include "evaluator/affine.hpp"

namespace physkin {

Rig::Rig(const BoundGarment& g, Arena& arena)
    : bones_(g.bones),
      dofs_(g.dofs),
      parents_(arena.copy(g.bone_parents, g.bones)),
      heads_(arena.copy(g.bone_heads, 3 * g.bones)),
      axis_(arena.copy(g.dof_axis, 3 * g.dofs)),
      rest_(arena.copy(g.dof_rest, g.dofs)),
      lower_(arena.copy(g.dof_lower, g.dofs)),
      upper_(arena.copy(g.dof_upper, g.dofs)) {
  auto* start = arena.take<std::int32_t>(g.bones + 1);
  auto* order = arena.take<std::int32_t>(g.dofs);
  int count = 0;
  for (int bone = 0; bone < g.bones; ++bone) {
    start[bone] = count;
    for (int k = 0; k < g.dofs; ++k) {
      if (g.dof_bone[k] == bone) order[count++] = k;
    }
  }
  start[g.bones] = count;
  dof_start_ = start;
  dof_order_ = order;
}

void Rig::compute_bone_transforms(const float* joint_positions, float* transforms) const {
  // First the posed heads stand in for the translations, because children hang from them.
  for (int bone = 0; bone < bones_; ++bone) {
    const Vector3 head = load_vector(heads_ + 3 * bone);
    Affine posed{kIdentity3, head};
    if (const int parent = parents_[bone]; parent >= 0) {
      posed = load_affine(transforms + 12 * parent);
      posed.translation = posed.translation + posed.linear * (head - load_vector(heads_ + 3 * parent));
    }
    for (int at = dof_start_[bone]; at < dof_start_[bone + 1]; ++at) {
      const int k = dof_order_[at];
      posed.linear = posed.linear * rotation(load_vector(axis_ + 3 * k), joint_positions[k] - rest_[k]);
    }
    store_affine(posed, transforms + 12 * bone);
  }
  for (int bone = 0; bone < bones_; ++bone) {
    Affine transform = load_affine(transforms + 12 * bone);
    transform.translation = transform.translation - transform.linear * load_vector(heads_ + 3 * bone);
    store_affine(transform, transforms + 12 * bone);
  }
}

void Rig::compute_pose_vector(const float* joint_positions, const float* gravity, float* pose) const {
  for (int k = 0; k < dofs_; ++k) {
    const float middle = 0.5f * (lower_[k] + upper_[k]), half = 0.5f * (upper_[k] - lower_[k]);
    pose[k] = std::clamp((joint_positions[k] - middle) / half, -1.0f, 1.0f);
  }
  std::copy(gravity, gravity + 3, pose + dofs_);
}

}  // namespace physkin

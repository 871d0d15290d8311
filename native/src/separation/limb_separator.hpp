// Arms and legs moved out of the trunk and of each other by a few damped Gauss-Newton steps on their joint positions.
// tests/reference/limb_separator.py says what is minimised.
#pragma once

#include <cstdint>
#include <vector>

#include "evaluator/affine.hpp"
#include "garment/finite.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

// Fields of `CollisionShape` in physkin_core/separation/collision_shape.py, flat; sizes follow from each other.
struct CollisionShape {
  std::vector<std::int32_t> parents, dof_bone, trunk_bones, sphere_bone, sphere_limb, sphere_joints, capsules, groups,
      pairs, limb_start, limb_dofs, limb_kind;
  std::vector<float> heads, dof_axis, dof_rest, dof_lower, dof_upper, trunk_heights, trunk_frame, trunk_coefficients,
      sphere_centre, sphere_radius, group_reach, allowed;
};

// [m] So near to a capsule's axis there is no way out to prefer: arms may pass through each other.
constexpr double kCapsuleBlur = 0.015;

// See `SeparationSettings` in physkin_core/separation/limb_separator.py.
struct SeparationSettings {
  float onset, softness, pull, damping, blend;
  int steps;
};

// Not for use by two threads at once. A frame allocates nothing.
class LimbSeparator {
 public:
  // Throws std::invalid_argument for arrays whose sizes do not match, an index out of range or a value that is not
  // finite.
  LimbSeparator(CollisionShape shape, const SeparationSettings& settings, const Kernels& kernels);
  LimbSeparator(const LimbSeparator&) = delete;  // the kernels' arguments point into it
  LimbSeparator& operator=(const LimbSeparator&) = delete;

  int dofs() const { return int(shape_.dof_bone.size()); }

  // joint_positions (dofs) [rad] to `separated` (dofs), which may be the same array; largest_change [rad]. Says so, and
  // changes nothing, where a position is not finite or too large.
  Rejection separate(const float* joint_positions, float* separated, float* largest_change) noexcept;

 private:
  static constexpr int kMostJoints = 8;

  struct Contact {
    float depth;
    Vector3 normal;
    float along;
  };
  // The quadratic that a step of one limb minimises. moved: whether it has left what was given.
  struct Normal {
    float curvature[kMostJoints][kMostJoints], slope[kMostJoints];
    bool met, moved;
  };
  // A limb's joints in a pose, those that it lacks zero: their axes, and axes x pivots.
  struct Joints {
    float axis[3][kMostJoints], moment[3][kMostJoints];
  };
  // The spheres of a group that may meet a capsule, or the trunk (-1), whose points they are from `trunk_point` on.
  struct Pair {
    int first, last, limb, target, other, trunk_point;
    float reach;
    const float* allowed;
  };
  // In a pose. inverse: of the squared length of its way.
  struct Capsule {
    Vector3 start, way;
    float inverse, narrow, wide;
  };

  void check() const;
  void plan();
  void pose_bone(int bone);
  void pose_limb(int limb);
  void place_spheres(int limb);
  void meet(const Pair& pair);
  void give_way(const Pair& pair, int sphere, const Contact& contact, float excess);
  void count(int sphere, int limb, Vector3 point, Vector3 direction, float share, float* way) const;
  void add(int limb, const float* way, float value, float weight, float counted, float sign);
  bool step(int limb, const float* given);
  void place_capsules();

  CollisionShape shape_;
  SeparationSettings settings_;
  const Kernels& kernels_;
  float per_softness_ = 0.0f;
  int limbs_ = 0, spheres_ = 0;
  // Bones that a frame needs, parents first: those that no limb moves, then by limb. A bone with joints that may move
  // is turned anew at every step, others keep the turn that they have in the frame.
  std::vector<int> fixed_bones_, limb_of_dof_, place_of_dof_;  // -1 where no limb moves by it, else which of its joints
  std::vector<std::vector<int>> limb_bones_, limb_spheres_;
  std::vector<char> turns_anew_;
  std::vector<int> dof_start_, dof_order_;  // degrees of freedom by bone
  std::vector<Vector3> offsets_;            // of spheres from their bone's head
  std::vector<Vector3> steps_;              // of bones' heads from their parents'
  std::vector<Pair> pairs_;
  std::vector<int> trunk_spheres_;
  Arena arena_;
  TrunkField trunk_;
  int trunk_points_ = 0;
  float *back_ = nullptr, *points_ = nullptr, *contacts_ = nullptr;
  std::vector<float> positions_;
  std::vector<Matrix3> turns_;  // by bone, against its parent
  std::vector<Affine> posed_;   // by bone: rotation, and where its head is
  std::vector<Vector3> centres_;
  std::vector<Capsule> capsules_;
  std::vector<Joints> joints_;  // by limb
  std::vector<Normal> normals_;
};

}  // namespace physkin

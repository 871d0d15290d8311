// Keeps cloth that hangs free out of legs, hips and trunk: garment nodes are moved out along the skin's normal, before
// skinning, so that all that is skinned to them (vertices, points, other meshes) goes along smoothly.
// physkin_core/runtime/skin_guard.py says which cloth that is, and fits the skin.
#pragma once

#include <vector>

#include "evaluator/affine.hpp"
#include "evaluator/skinner.hpp"
#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

class SkinGuard {
 public:
  // Of a garment that is guarded. The data must be valid; they are copied into the arena.
  SkinGuard(const BoundGarment& garment, const Kernels& kernels, Arena& arena);

  // Moves node_transforms (nodes, 3, 4). bone_transforms (bones, 3, 4). Allocates nothing.
  void keep_out(const float* bone_transforms, float* node_transforms) noexcept;

 private:
  // A part of the skin. Around each stretch of its axis, from a bone to the next, it lies within a width [m].
  struct Part {
    TrunkField field;
    const std::int32_t* bones;
    const float* frame;  // (3, 4) from the canonical pose to the field's own axes
    float* back;         // what field.back points to
    float widths[kSkinBones];
    Vector3 axis[kSkinBones + 1];  // posed
    const float* gaps;             // (samples,) [m]
    std::int32_t* near;            // samples in this frame, near_count of them
    int near_count;
  };

  void pose(Part& part, const float* bone_transforms) const noexcept;
  void find_near(Part& part) noexcept;
  // Adds what the samples near a part lack, and keeps those that may after a move. Whether any lacks something.
  bool add_lacking(Part& part) noexcept;
  void add(int sample, float lack, Vector3 normal) noexcept;
  void move_nodes(float* node_transforms) noexcept;
  void move_near_samples() noexcept;

  const Kernels& kernels_;
  int nodes_, samples_, influences_;
  Skinner skinner_;
  const std::int32_t* influence_nodes_;
  const float* influence_weights_;
  const float* shares_;  // (samples,)
  std::vector<Part> parts_;
  float* skinned_;    // (samples, 3)
  float* positions_;  // (3, samples)
  float* beyond_;     // (samples,) squared [m2], below zero within the width of a part
  float* points_;     // (3, samples) of those near a part, and (4, samples) what the kernel says of them
  float* contacts_;
  float* lacks_;  // (nodes, 4): what samples lack in a pass, as vectors and by how much they count
  float* moved_;  // (nodes, 3) by this frame
};

}  // namespace physkin

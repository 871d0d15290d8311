// The per-frame path: joint positions to garment vertices and normals. Single-threaded; a frame allocates nothing.
#pragma once

#include <optional>

#include "arena.hpp"
#include "bound_garment.hpp"
#include "garment_nodes.hpp"
#include "kernels.hpp"
#include "mlp.hpp"
#include "push_out.hpp"
#include "rig.hpp"

namespace physkin {

class Evaluator {
 public:
  // Validates and copies the garment, and with it what keeps it out of the body; throws std::invalid_argument.
  Evaluator(const BoundGarment& garment, const Kernels& kernels, const BoundPushOut* push_out = nullptr);
  Evaluator(const Evaluator&) = delete;  // its members point into its own arena
  Evaluator& operator=(const Evaluator&) = delete;

  // joint_positions (dofs) in radians, gravity (3): unit direction in the root frame. Throws std::invalid_argument, and
  // leaves the rows and the last frame as they were, if an input or what the networks make of it is not finite.
  void evaluate(const float* joint_positions, const float* gravity, const VertexRows& rows);

  // Skinning alone, without push-out, with the given node_transforms (nodes, 3, 4).
  void skin(const float* node_transforms, const VertexRows& rows);

  // (nodes, 3, 4) of the last frame, root frame, metres.
  const float* node_transforms() const { return node_transforms_; }

  // Contact that the push-out left in the last frame; none without push-out.
  const ContactResidual& residual() const { return residual_; }

  int dofs() const { return rig_.dofs(); }
  int nodes() const { return garment_nodes_.count(); }
  int vertex_count() const { return blocks_.vertex_count; }
  const char* instruction_set() const { return kernels_.instruction_set; }

 private:
  // Members are built in this order, so that a frame walks the arena from front to back.
  const Kernels& kernels_;
  Arena arena_;
  Rig rig_;
  Mlp pose_modulator_;
  Mlp node_deformer_;
  GarmentNodes garment_nodes_;
  SkinningBlocks blocks_;
  int deformer_bone_count_;
  const std::int32_t* deformer_bones_;
  float* pose_;
  float* bone_transforms_;
  float* deformer_input_;
  float* node_transforms_;
  float* skinning_matrices_;
  std::optional<PushOut> push_out_;
  ContactResidual residual_;
};

}  // namespace physkin

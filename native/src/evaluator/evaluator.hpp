// The per-frame path: joint positions to garment vertices and normals. Single-threaded; a frame allocates nothing.
#pragma once

#include <optional>
#include <string>

#include "evaluator/face_normals.hpp"
#include "evaluator/garment_nodes.hpp"
#include "evaluator/learnt_sway.hpp"
#include "evaluator/mlp.hpp"
#include "evaluator/moment.hpp"
#include "evaluator/pace.hpp"
#include "evaluator/rig.hpp"
#include "evaluator/skinner.hpp"
#include "garment/bound_garment.hpp"
#include "garment/finite.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

// Where normals come from: rest normals carried by skinning, or the faces of the posed mesh.
enum class Normals { skinned, faces };

// "skinned" or "faces"; throws std::invalid_argument for another name.
Normals select_normals(const std::string& name);

// [rad], and of gravity, as JUMP of pace.py: where a frame differs from the last one by more, that one does not count.
constexpr float kJump = 0.5f;

struct EvaluatorOptions {
  Precision precision = Precision::fp32;
  Normals normals = Normals::skinned;
};

class Evaluator {
 public:
  // Validates and copies the garment; throws std::invalid_argument. `shared`: of a body with the same garment model,
  // its modulation not folded in either, whose network weights are used; it must live longer.
  Evaluator(const BoundGarment& garment, const Kernels& kernels, const EvaluatorOptions& options = {},
            const Evaluator* shared = nullptr);
  Evaluator(const Evaluator&) = delete;  // its members point into its own arena
  Evaluator& operator=(const Evaluator&) = delete;

  // One frame. joint_positions (dofs) in radians, gravity (3): unit direction in the root frame; moment: null for a drape
  // by itself. If an input or what the networks make of it is not finite, says so and leaves the rows as they were;
  // after such networks the next frame is a first one.
  Rejection step(const float* joint_positions, const float* gravity, const VertexRows& rows,
                 const Moment* moment = nullptr) noexcept;

  // Skinning alone, from the given node_transforms (nodes, 3, 4), which must be finite.
  Rejection skin(const float* node_transforms, const VertexRows& rows) noexcept;

  // The stages of a frame, in order, each from what the last one left; `step` checks what lies between them.
  void pose(const float* joint_positions, const float* gravity) noexcept;
  // Takes over what `pose` left in another garment on the same body, under a gravity of its own.
  void pose_as(const Evaluator& other, const float* gravity) noexcept;
  const float* run_networks(const Moment* moment = nullptr) noexcept;  // corrections (nodes, 9 or 12)
  void compose_nodes(const float* corrections, const Moment* moment = nullptr) noexcept;
  void compute_normals(const VertexRows& rows) noexcept;  // from faces; does nothing if they are skinned

  // (nodes, 3, 4) of the last frame, root frame, metres.
  const float* node_transforms() const { return node_transforms_; }
  // Whether a joint, or gravity, is far from where the frame before had it.
  bool jumped() const { return joints_jump_ || gravity_jumps_; }
  // What the networks last gave, (nodes, 9 or 12); zeros before the first frame.
  const float* corrections() const { return corrections_; }

  int dofs() const { return rig_.dofs(); }
  int nodes() const { return garment_nodes_.count(); }
  int correction_size() const { return garment_nodes_.correction_size(); }
  int vertex_count() const { return skinner_.vertex_count(); }
  int skinning_terms() const { return skinner_.terms(); }
  const char* instruction_set() const { return kernels_.instruction_set; }
  Precision precision() const { return precision_; }

 private:
  friend class EvaluatorBatch;
  friend class OutfitEvaluator;

  Rejection check_inputs(const float* joint_positions, const float* gravity, const Moment* moment = nullptr) const noexcept;
  Rejection check_corrections() noexcept;
  Rejection check_nodes() noexcept;
  void forget() noexcept;  // what was before
  void gather_deformer_input() noexcept;

  // Members are built in this order, so that a frame walks the arena from front to back.
  const Kernels& kernels_;
  Precision precision_;
  Arena arena_;
  Rig rig_;
  Mlp pose_modulator_;
  Mlp node_deformer_;
  std::optional<LearntSway> learnt_sway_;
  GarmentNodes garment_nodes_;
  Pace pace_;
  Skinner skinner_;
  int bone_count_, deformer_bone_count_;
  const std::int32_t* deformer_bones_;
  const float* pose_modulation_;  // null where it is folded into the pose modulator
  float* pose_;
  float* last_positions_;  // (dofs) of the frame before
  float last_gravity_[3] = {};
  bool joints_jump_ = true, gravity_jumps_ = true;  // since then
  float* bone_transforms_;
  float* deformer_input_;
  float* node_transforms_;
  const float* corrections_;
  std::optional<FaceNormals> face_normals_;
};

}  // namespace physkin

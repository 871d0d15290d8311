// The stages of one garment's frame: joint positions to garment vertices and normals. A frame allocates nothing.
#pragma once

#include <optional>

#include "evaluator/contact.hpp"
#include "evaluator/garment_input.hpp"
#include "evaluator/garment_nodes.hpp"
#include "evaluator/learnt_sway.hpp"
#include "evaluator/mlp.hpp"
#include "evaluator/pace.hpp"
#include "evaluator/rig.hpp"
#include "evaluator/skin_surface.hpp"
#include "evaluator/skinner.hpp"
#include "garment/bound_garment.hpp"
#include "garment/finite.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

// [rad], and of gravity: where a frame differs from the last one by more, that one does not count.
constexpr float kJump = 0.5f;

// Bytes that the last frame of a garment by itself touched, or where there was none, that a first one will. An array
// counts once, in the first stage that needs it; what it holds for other frames does not count.
struct StageBytes {
  std::size_t posing, networks, composition, skinning, normals;
};

class GarmentEvaluator {
 public:
  // Validates and copies the garment; throws std::invalid_argument. precision: of network weights.
  GarmentEvaluator(const BoundGarment& garment, const Kernels& kernels, Precision precision);
  GarmentEvaluator(const GarmentEvaluator&) = delete;  // its members point into its own arena
  GarmentEvaluator& operator=(const GarmentEvaluator&) = delete;

  // From the next frame on it is made of another of its fabrics, or, -1, of what it is bound as.
  void set_fabric(int fabric) noexcept;

  // In order, each from what the last one left. joint_positions (dofs) in radians.
  void pose(const float* joint_positions, const GarmentInput& input) noexcept;
  // Takes over what `pose` left in another garment on the same body, under a gravity of its own.
  void pose_as(const GarmentEvaluator& other, const GarmentInput& input) noexcept;
  void run_networks(const GarmentInput& input) noexcept;
  void compose_nodes(const GarmentInput& input) noexcept;
  // As of `Skinner`.
  void skin(const VertexRows& rows, bool are_moved) noexcept {
    skinner_.skin(node_transforms_, detail_offsets_, rows, are_moved);
  }
  void compute_normals(const VertexRows& rows, bool were_moved) noexcept { skinner_.compute_normals(rows, were_moved); }

  // What `run_networks` and `compose_nodes` have left is refused where it is not finite. The next frame is then a first
  // one.
  Rejection check_corrections() noexcept;
  Rejection check_nodes() noexcept;

  // (nodes, 3, 4) of the last frame, root frame, metres.
  const float* node_transforms() const { return node_transforms_; }
  // Whether a joint, or gravity, is far from where the frame before had it.
  bool jumped() const { return joints_jump_ || gravity_jumps_; }
  // How far samples of it are from the skin in the last frame, (clearances) [m]. See Contact.
  int clearances() const { return contact_ ? contact_->measured() : 0; }
  void measure_clearance(float* clearance) noexcept {
    if (contact_) contact_->measure(skin_->posed(), node_transforms_, detail_offsets_, clearance);
  }
  // What the networks last gave, (nodes, 12); zeros before the first frame.
  const float* corrections() const { return corrections_; }

  // Offsets of detail nodes in the last frame that was not refused, (detail_nodes, 3) at rest, metres; zeros before the
  // first one.
  const float* detail_offsets() const { return detail_offsets_; }

  int dofs() const { return rig_.dofs(); }
  int nodes() const { return garment_nodes_.count(); }
  int detail_nodes() const { return skinner_.detail_nodes(); }
  int vertex_count() const { return skinner_.vertex_count(); }
  // Rows of the garment, with normals, included.
  StageBytes stage_bytes() const;

 private:
  void forget() noexcept;  // all that was before
  void gather_deformer_input() noexcept;
  void weigh() noexcept;  // how gravity pulls in the pose vector

  // Members are built in this order, so that a frame walks the arena from front to back. Between them stands where each
  // stage ends in it.
  Arena arena_;
  Rig rig_;
  std::size_t rig_end_ = arena_.touched();
  Mlp pose_modulator_;
  std::size_t pose_end_ = arena_.touched();
  std::optional<Mlp> other_pose_modulator_;  // of other fabrics: not counted, since a frame has one of both
  std::size_t other_bytes_ = arena_.leave_out_since(pose_end_);
  const float *fabric_modulations_, *fabric_weights_, *fabric_sway_shifts_;
  int fabric_sway_, fabric_ = -1;
  Mlp node_deformer_;
  std::optional<Mlp> detail_;  // from the node deformer's last hidden layer to offsets of detail nodes
  std::size_t still_end_ = arena_.touched();
  std::optional<LearntSway> learnt_sway_;
  std::size_t networks_end_ = arena_.touched();
  GarmentNodes garment_nodes_;
  Pace pace_;
  std::optional<SkinSurface> skin_;
  std::optional<Contact> contact_;
  std::size_t nodes_end_ = arena_.touched();
  Skinner skinner_;
  std::size_t skinner_end_ = arena_.touched();
  int bone_count_, deformer_bone_count_;
  const std::int32_t* deformer_bones_;
  float* pose_;
  float* last_positions_;  // (dofs) of the frame before
  float last_gravity_[3] = {};
  bool joints_jump_ = true, gravity_jumps_ = true;  // since then
  float* bone_transforms_;
  float* deformer_input_;
  float* node_transforms_;
  const float* still_corrections_;  // without those of sway
  const float* corrections_;
  const float* given_offsets_ = nullptr;  // of detail nodes, by the networks; none without detail
  const float* detail_offsets_;           // that are shown
};

}  // namespace physkin

#include "evaluator/evaluator.hpp"

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <stdexcept>

namespace physkin {
namespace {

const float* copy_modulation(const BoundGarment& g, Arena& arena) {
  float* modulation = arena.take<float>(std::size_t(g.modulation_size) + kGroup);
  std::copy_n(g.pose_modulation, g.modulation_size, modulation);
  return modulation;
}

// Whether any of the values is far from the last one, which it then takes the place of.
bool take_over(const float* values, int count, float* last) {
  bool jumps = false;
  for (int k = 0; k < count; ++k) jumps |= !(std::fabs(values[k] - last[k]) <= kJump);  // the last may be no number
  std::copy_n(values, count, last);
  return jumps;
}

// What reads bone transforms sets large rotations off against large translations: in 8 bits that layer, a thirtieth of
// the network weights, puts vertices out by three to seven times as much as all others together. What reads the pose
// vector, a fiftieth, is the next: of the skirt it makes the largest errors.
Precision of_inputs(Precision precision) {
  return precision == Precision::int8 ? Precision::bf16 : precision;
}

const BoundGarment& validated(const BoundGarment& garment) {
  validate(garment);
  return garment;
}

}  // namespace

Normals select_normals(const std::string& name) {
  if (name == "skinned") return Normals::skinned;
  if (name == "faces") return Normals::faces;
  throw std::invalid_argument("normals '" + name + "' are unknown; they may be skinned or faces");
}

Evaluator::Evaluator(const BoundGarment& g, const Kernels& kernels, const EvaluatorOptions& options,
                     const Evaluator* shared)
    : kernels_(kernels),
      precision_(options.precision),
      rig_(validated(g), arena_),
      pose_modulator_(g.pose_layers, g.activation, of_inputs(precision_), precision_, kernels, arena_,
                      shared == nullptr ? nullptr : &shared->pose_modulator_),
      node_deformer_(g.deformer_layers, g.activation, of_inputs(precision_), precision_, kernels, arena_,
                     shared == nullptr ? nullptr : &shared->node_deformer_, 1),
      learnt_sway_(g.sway_layers.empty() ? std::optional<LearntSway>()
                                         : std::make_optional<LearntSway>(g, of_inputs(precision_), precision_,
                                                                          kernels, arena_)),
      garment_nodes_(g, arena_),
      pace_(g.nodes, arena_),
      skinner_(g, kernels, arena_),
      bone_count_(g.bones),
      deformer_bone_count_(g.deformer_bone_count),
      deformer_bones_(arena_.copy(g.deformer_bones, g.deformer_bone_count)),
      pose_modulation_(g.modulation_size == 0 ? nullptr : copy_modulation(g, arena_)),
      pose_(arena_.take<float>(g.dofs + 3)),
      last_positions_(arena_.take<float>(g.dofs)),
      bone_transforms_(arena_.take<float>(12 * g.bones)),
      deformer_input_(arena_.take<float>(12 * g.deformer_bone_count)),
      node_transforms_(arena_.take<float>(12 * g.nodes)),
      corrections_(arena_.take<float>(g.deformer_layers.back().outputs)) {
  if (options.normals == Normals::faces) face_normals_.emplace(g, arena_);
}

Rejection Evaluator::check_inputs(const float* joint_positions, const float* gravity,
                                  const Moment* moment) const noexcept {
  if (const auto bad = reject_beyond("joint_positions", joint_positions, rig_.dofs(), FLT_MAX)) return bad;
  if (const auto bad = reject_beyond("gravity", gravity, 3, FLT_MAX)) return bad;
  if (moment == nullptr) return {};
  for (const auto& [name, value] : {std::pair{"twist", moment->twist}, {"passed", moment->passed},
                                    {"sway", moment->sway}, {"elapsed", moment->elapsed}, {"moves", moment->moves}}) {
    if (const auto bad = reject_beyond(name, &value, 1, FLT_MAX)) return bad;
  }
  if (const auto bad = reject_beyond("velocity", moment->velocity, 3, FLT_MAX)) return bad;
  return reject_beyond("turning", moment->turning, 3, FLT_MAX);
}

Rejection Evaluator::check_corrections() noexcept {
  const Rejection bad = reject_beyond("node deformer output", corrections_, node_deformer_.outputs(), kLargest);
  if (bad) forget();
  return bad;
}

Rejection Evaluator::check_nodes() noexcept {
  const Rejection bad = skinner_.check(node_transforms_);
  if (bad) forget();
  return bad;
}

void Evaluator::forget() noexcept {
  pace_.forget();
  if (learnt_sway_) learnt_sway_->forget();
}

Rejection Evaluator::step(const float* joint_positions, const float* gravity, const VertexRows& rows,
                          const Moment* moment) noexcept {
  if (const auto bad = check_inputs(joint_positions, gravity, moment)) return bad;
  pose(joint_positions, gravity);
  run_networks(moment);
  if (const auto bad = check_corrections()) return bad;
  compose_nodes(corrections_, moment);
  if (const auto bad = check_nodes()) return bad;
  skinner_.skin(node_transforms_, rows);
  compute_normals(rows);
  return {};
}

void Evaluator::pose(const float* joint_positions, const float* gravity) noexcept {
  joints_jump_ = take_over(joint_positions, rig_.dofs(), last_positions_);
  gravity_jumps_ = take_over(gravity, 3, last_gravity_);
  rig_.compute_bone_transforms(joint_positions, bone_transforms_);
  rig_.compute_pose_vector(joint_positions, gravity, pose_);
  gather_deformer_input();
}

void Evaluator::pose_as(const Evaluator& other, const float* gravity) noexcept {
  std::copy_n(other.bone_transforms_, 12 * bone_count_, bone_transforms_);
  std::copy_n(other.pose_, rig_.dofs(), pose_);
  std::copy_n(other.last_positions_, rig_.dofs(), last_positions_);
  joints_jump_ = other.joints_jump_;
  gravity_jumps_ = take_over(gravity, 3, last_gravity_);
  std::copy_n(gravity, 3, pose_ + rig_.dofs());
  gather_deformer_input();
}

void Evaluator::gather_deformer_input() noexcept {
  for (int k = 0; k < deformer_bone_count_; ++k) {
    std::copy_n(bone_transforms_ + 12 * deformer_bones_[k], 12, deformer_input_ + 12 * k);
  }
}

const float* Evaluator::run_networks(const Moment* moment) noexcept {
  corrections_ = node_deformer_.run(deformer_input_, pose_modulator_.run(pose_, pose_modulation_));
  if (moment != nullptr && learnt_sway_) {
    corrections_ = learnt_sway_->added(corrections_, last_positions_, last_gravity_, *moment);
  }
  return corrections_;
}

void Evaluator::compose_nodes(const float* corrections, const Moment* moment) noexcept {
  garment_nodes_.compose(bone_transforms_, corrections, node_transforms_);
  if (moment == nullptr) return;
  pace_.keep(garment_nodes_, bone_transforms_, jumped() ? -1.0f : moment->passed, node_transforms_);
  garment_nodes_.twist(bone_transforms_, moment->twist, node_transforms_);
}

Rejection Evaluator::skin(const float* node_transforms, const VertexRows& rows) noexcept {
  if (const auto bad = skinner_.check(node_transforms)) return bad;
  skinner_.skin(node_transforms, rows);
  compute_normals(rows);
  return {};
}

void Evaluator::compute_normals(const VertexRows& rows) noexcept {
  if (face_normals_ && rows.with_normals) face_normals_->apply(rows);
}

}  // namespace physkin

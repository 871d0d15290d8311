#include "evaluator.hpp"

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "row_reading.hpp"
#include "skinning_blocks.hpp"

namespace physkin {
namespace {

// Metres; far beyond any garment, and small enough that nothing computed from it overflows.
constexpr float kLargest = 1e6f;

const float* copy_modulation(const BoundGarment& g, Arena& arena) {
  float* modulation = arena.take<float>(std::size_t(g.modulation_size) + kGroup);
  std::copy_n(g.pose_modulation, g.modulation_size, modulation);
  return modulation;
}

// What reads bone transforms sets large rotations off against large translations: in 8 bits that layer, a thirtieth of
// the network weights, puts vertices out by three to seven times as much as all others together.
Precision of_bone_transforms(Precision precision) {
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
      pose_modulator_(g.pose_layers, g.activation, precision_, precision_, kernels, arena_,
                      shared == nullptr ? nullptr : &shared->pose_modulator_),
      node_deformer_(g.deformer_layers, g.activation, of_bone_transforms(precision_), precision_, kernels, arena_,
                     shared == nullptr ? nullptr : &shared->node_deformer_, 1),
      garment_nodes_(g, arena_),
      blocks_(pack_skinning_blocks(g, arena_)),
      deformer_bone_count_(g.deformer_bone_count),
      deformer_bones_(arena_.copy(g.deformer_bones, g.deformer_bone_count)),
      pose_modulation_(g.modulation_size == 0 ? nullptr : copy_modulation(g, arena_)),
      pose_(arena_.take<float>(g.dofs + 3)),
      bone_transforms_(arena_.take<float>(12 * g.bones)),
      deformer_input_(arena_.take<float>(12 * g.deformer_bone_count)),
      node_transforms_(arena_.take<float>(12 * g.nodes)),
      skinning_matrices_(arena_.take<float>(12 * g.nodes)),
      corrections_(arena_.take<float>(g.deformer_layers.back().outputs)) {
  if (options.normals == Normals::faces) face_normals_.emplace(g, arena_);
  if (shared == nullptr) choose_reading(g);
}

Rejection Evaluator::check_inputs(const float* joint_positions, const float* gravity) const noexcept {
  if (const auto bad = reject_beyond("joint_positions", joint_positions, rig_.dofs(), FLT_MAX)) return bad;
  return reject_beyond("gravity", gravity, 3, FLT_MAX);
}

Rejection Evaluator::check_corrections() const noexcept {
  return reject_beyond("node deformer output", corrections_, node_deformer_.outputs(), kLargest);
}

Rejection Evaluator::step(const float* joint_positions, const float* gravity, const VertexRows& rows) noexcept {
  if (const auto bad = check_inputs(joint_positions, gravity)) return bad;
  pose(joint_positions, gravity);
  run_networks();
  if (const auto bad = check_corrections()) return bad;
  compose_nodes(corrections_);
  if (const auto bad = check_nodes(node_transforms_)) return bad;
  skin_checked(node_transforms_, rows);
  compute_normals(rows);
  return {};
}

void Evaluator::pose(const float* joint_positions, const float* gravity) noexcept {
  rig_.compute_bone_transforms(joint_positions, bone_transforms_);
  rig_.compute_pose_vector(joint_positions, gravity, pose_);
  for (int k = 0; k < deformer_bone_count_; ++k) {
    std::copy_n(bone_transforms_ + 12 * deformer_bones_[k], 12, deformer_input_ + 12 * k);
  }
}

const float* Evaluator::run_networks() noexcept {
  return corrections_ = node_deformer_.run(deformer_input_, pose_modulator_.run(pose_, pose_modulation_));
}

void Evaluator::compose_nodes(const float* corrections) noexcept {
  garment_nodes_.compose(bone_transforms_, corrections, node_transforms_);
}

Rejection Evaluator::check_nodes(const float* node_transforms) const noexcept {
  return reject_beyond("node_transforms", node_transforms, 12 * std::size_t(nodes()), kLargest);
}

Rejection Evaluator::skin(const float* node_transforms, const VertexRows& rows) noexcept {
  if (const auto bad = check_nodes(node_transforms)) return bad;
  skin_checked(node_transforms, rows);
  compute_normals(rows);
  return {};
}

void Evaluator::skin_checked(const float* node_transforms, const VertexRows& rows) noexcept {
  garment_nodes_.compute_skinning_matrices(node_transforms, skinning_matrices_);
  kernels_.skin(blocks_, skinning_matrices_, rows);
}

void Evaluator::compute_normals(const VertexRows& rows) noexcept {
  if (face_normals_ && rows.with_normals) face_normals_->apply(rows);
}

void Evaluator::choose_reading(const BoundGarment& g) {
  const ZeroSkipping skipping = select_zero_skipping();
  const bool may_skip = skipping == ZeroSkipping::measured && g.activation == Activation::relu;
  std::vector<RowReading> candidates;
  for (const bool fetch_ahead : {false, true}) {
    candidates.push_back({skipping == ZeroSkipping::always, fetch_ahead});
    if (may_skip) candidates.push_back({true, fetch_ahead});
  }

  constexpr int kPoses = 16, kRounds = 5;
  constexpr float kGravity[3] = {0.0f, 0.0f, -1.0f};
  std::vector<float> joint_positions(g.dofs);
  RowReadingTrial modulator(pose_modulator_, candidates), deformer(node_deformer_, candidates);
  for (std::size_t round = 0; round < kRounds * candidates.size(); ++round) {
    modulator.begin_round(round % candidates.size());
    deformer.begin_round(round % candidates.size());
    for (int k = 0; k < kPoses; ++k) {
      // Poses spread over the joint limits, the same at every start.
      for (int d = 0; d < g.dofs; ++d) {
        const float share = std::fmod(0.6180340f * float((k + 1) * (d + 1)), 1.0f);
        joint_positions[d] = g.dof_lower[d] + share * (g.dof_upper[d] - g.dof_lower[d]);
      }
      pose(joint_positions.data(), kGravity);
      deformer.timed_run(deformer_input_, modulator.timed_run(pose_, pose_modulation_));
    }
    modulator.end_round();
    deformer.end_round();
  }
  modulator.decide();
  deformer.decide();
}

}  // namespace physkin

#include "evaluator/garment_evaluator.hpp"

#include <algorithm>
#include <cmath>

namespace physkin {
namespace {

// Keeps the values in place of the last ones. Whether any of them is far from its last one.
bool jumps_to(const float* values, int count, float* last) {
  bool jumps = false;
  for (int k = 0; k < count; ++k) jumps |= !(std::fabs(values[k] - last[k]) <= kJump);  // the last may be no number
  std::copy_n(values, count, last);
  return jumps;
}

// What reads bone transforms sets large rotations off against large translations: in 8 bits that layer, a thirtieth of
// the network weights, puts vertices out by three to seven times as much as all others together. What reads the pose
// vector, a fiftieth, is the next: of the skirt it makes the largest errors.
Precision of_first_layers(Precision precision) { return precision == Precision::int8 ? Precision::bf16 : precision; }

// (count, width) in rows of so much room.
const float* padded_rows(const float* values, int count, int width, std::size_t room, Arena& arena) {
  auto* rows = arena.take<float>(std::size_t(count) * room);
  for (int k = 0; k < count; ++k) std::copy_n(values + std::ptrdiff_t(k) * width, width, rows + std::size_t(k) * room);
  return rows;
}

// From the node deformer's last hidden layer to features, and from these to offsets of detail nodes.
std::optional<Mlp> detail_network(const BoundGarment& g, Precision precision, const Kernels& kernels, Arena& arena) {
  if (!g.has_detail()) return {};
  const std::vector<float> no_bias(std::size_t(g.detail_numbers));
  const DenseWeights offsets{g.detail_numbers, g.detail_features, g.detail_offsets, no_bias.data()};
  const std::vector<DenseWeights> layers{g.detail_layers[0], offsets};
  return std::make_optional<Mlp>(layers, precision, precision, kernels, arena);
}

const BoundGarment& validated(const BoundGarment& garment) {
  validate(garment);
  return garment;
}

}  // namespace

GarmentEvaluator::GarmentEvaluator(const BoundGarment& g, const Kernels& kernels, Precision precision)
    : rig_(validated(g), arena_),
      pose_modulator_(g.pose_layers, of_first_layers(precision), precision, kernels, arena_),
      other_pose_modulator_(g.fabrics > 0 ? std::make_optional<Mlp>(g.fabric_pose_layers, of_first_layers(precision),
                                                                    precision, kernels, arena_)
                                          : std::optional<Mlp>()),
      fabric_modulations_(g.fabrics > 0 ? padded_rows(g.fabric_modulations, g.fabrics, g.fabric_modulation,
                                                      other_pose_modulator_->modulation_room(), arena_)
                                        : nullptr),
      fabric_weights_(arena_.copy(g.fabric_weights, g.fabrics)),
      fabric_sway_shifts_(arena_.copy(g.fabric_sway_shifts, std::size_t(g.fabrics) * std::size_t(g.fabric_sway))),
      fabric_sway_(g.fabric_sway),
      node_deformer_(g.deformer_layers, of_first_layers(precision), precision, kernels, arena_),
      detail_(detail_network(g, precision, kernels, arena_)),
      learnt_sway_(g.sways_by_network()
                       ? std::make_optional<LearntSway>(g, of_first_layers(precision), precision, kernels, arena_)
                       : std::optional<LearntSway>()),
      garment_nodes_(g, arena_),
      pace_(g.nodes, g.has_detail() ? g.detail_numbers / 3 : 0, arena_),
      skin_(g.meets_skin() ? std::make_optional<SkinSurface>(g, kernels, arena_) : std::optional<SkinSurface>()),
      contact_(g.meets_skin() ? std::make_optional<Contact>(g, kernels, arena_) : std::optional<Contact>()),
      skinner_(g, kernels, arena_),
      bone_count_(g.bones),
      deformer_bone_count_(g.deformer_bone_count),
      deformer_bones_(arena_.copy(g.deformer_bones, g.deformer_bone_count)),
      pose_(arena_.take<float>(g.dofs + 3)),
      last_positions_(arena_.take<float>(g.dofs)),
      bone_transforms_(arena_.take<float>(12 * g.bones)),
      deformer_input_(arena_.take<float>(12 * g.deformer_bone_count)),
      node_transforms_(arena_.take<float>(12 * g.nodes)),
      still_corrections_(arena_.take<float>(12 * g.nodes)),
      corrections_(still_corrections_),
      detail_offsets_(pace_.offsets()) {}

Rejection GarmentEvaluator::check_corrections() noexcept {
  Rejection bad = reject_beyond("corrections of garment nodes", corrections_, node_deformer_.outputs(), kLargest);
  if (!bad && detail_) bad = skinner_.check_offsets(given_offsets_);
  if (bad) forget();
  return bad;
}

Rejection GarmentEvaluator::check_nodes() noexcept {
  const Rejection bad = skinner_.check(node_transforms_);
  if (bad) forget();
  return bad;
}

void GarmentEvaluator::forget() noexcept {
  pace_.forget();
  if (learnt_sway_) learnt_sway_->forget();
}

void GarmentEvaluator::pose(const float* joint_positions, const GarmentInput& input) noexcept {
  joints_jump_ = jumps_to(joint_positions, rig_.dofs(), last_positions_);
  gravity_jumps_ = jumps_to(input.gravity, 3, last_gravity_);
  rig_.compute_bone_transforms(joint_positions, bone_transforms_);
  rig_.compute_pose_vector(joint_positions, input.gravity, pose_);
  weigh();
  gather_deformer_input();
}

void GarmentEvaluator::pose_as(const GarmentEvaluator& other, const GarmentInput& input) noexcept {
  std::copy_n(other.bone_transforms_, 12 * bone_count_, bone_transforms_);
  std::copy_n(other.pose_, rig_.dofs(), pose_);
  std::copy_n(other.last_positions_, rig_.dofs(), last_positions_);
  joints_jump_ = other.joints_jump_;
  gravity_jumps_ = jumps_to(input.gravity, 3, last_gravity_);
  std::copy_n(input.gravity, 3, pose_ + rig_.dofs());
  weigh();
  gather_deformer_input();
}

void GarmentEvaluator::set_fabric(int fabric) noexcept {
  fabric_ = fabric;
  if (learnt_sway_)
    learnt_sway_->shift(fabric < 0 ? nullptr : fabric_sway_shifts_ + std::ptrdiff_t(fabric) * fabric_sway_);
}

void GarmentEvaluator::weigh() noexcept {
  if (fabric_ < 0) return;
  for (int k = 0; k < 3; ++k) pose_[rig_.dofs() + k] *= fabric_weights_[fabric_];
}

void GarmentEvaluator::gather_deformer_input() noexcept {
  for (int k = 0; k < deformer_bone_count_; ++k) {
    std::copy_n(bone_transforms_ + 12 * deformer_bones_[k], 12, deformer_input_ + 12 * k);
  }
}

void GarmentEvaluator::run_networks(const GarmentInput& input) noexcept {
  const float* modulation =
      fabric_ < 0 ? pose_modulator_.run(pose_, nullptr)
                  : other_pose_modulator_->run(
                        pose_, fabric_modulations_ + std::size_t(fabric_) * other_pose_modulator_->modulation_room());
  corrections_ = still_corrections_ = node_deformer_.run(deformer_input_, modulation);
  if (detail_) given_offsets_ = detail_->run(node_deformer_.last_hidden(), nullptr);
  if (learnt_sway_) corrections_ = learnt_sway_->added(still_corrections_, last_positions_, bone_transforms_, input);
}

void GarmentEvaluator::compose_nodes(const GarmentInput& input) noexcept {
  garment_nodes_.compose(bone_transforms_, corrections_, node_transforms_);
  const float passed = jumped() ? -1.0f : input.passed;
  pace_.keep(garment_nodes_, bone_transforms_, passed, node_transforms_, given_offsets_);
  if (input.passed == kStandsAlone) pace_.forget();
  detail_offsets_ = pace_.offsets();
  if (!contact_) return;
  skin_->pose(bone_transforms_);
  detail_offsets_ = contact_->keep_out(skin_->posed(), node_transforms_, detail_offsets_);
}

}  // namespace physkin

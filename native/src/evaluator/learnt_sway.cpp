#include "evaluator/learnt_sway.hpp"

#include <algorithm>
#include <cmath>

#include "evaluator/affine.hpp"
#include "garment/finite.hpp"

namespace physkin {
namespace {

std::vector<DenseWeights> part(const std::vector<DenseWeights>& layers, int first, int count) {
  return {layers.begin() + first, layers.begin() + first + count};
}

// In double precision: the square of any float is finite.
float softly(double value, double largest) {
  const double share = value / largest;
  return float(value / std::sqrt(1 + share * share));
}

Oscillators oscillators_of(const BoundGarment& g, Arena& arena) {
  const int count = g.sway_states;
  float *rest_real = arena.take<float>(count), *rest_imaginary = arena.take<float>(count);
  for (int k = 0; k < count; ++k) {
    const float size = std::hypot(g.sway_rates[k], g.sway_turns[k]);
    rest_real[k] = g.sway_rates[k] / size;
    rest_imaginary[k] = g.sway_turns[k] / size;
  }
  const float *rates = arena.copy(g.sway_rates, count), *turns = arena.copy(g.sway_turns, count);
  return {count, rates, turns, rest_real, rest_imaginary, arena.take<float>(count), arena.take<float>(count)};
}

}  // namespace

LearntSway::LearntSway(const BoundGarment& g, Precision of_inputs, Precision others, const Kernels& kernels,
                       Arena& arena)
    : kernels_(kernels),
      joint_count_(g.sway_joint_count),
      thigh_count_(g.sway_thigh_count),
      outputs_(g.sway_layers.back().outputs),
      joints_(arena.copy(g.sway_joints, g.sway_joint_count)),
      thighs_(arena.copy(g.sway_thighs, g.sway_thigh_count)),
      middle_(arena.take<float>(joint_count_)),
      half_(arena.take<float>(joint_count_)),
      oscillators_(oscillators_of(g, arena)),
      driver_(part(g.sway_layers, 0, 2), of_inputs, of_inputs, kernels, arena),
      reader_(part(g.sway_layers, 2, 3), of_inputs, others, kernels, arena),
      driver_width_(g.sway_layers[0].outputs),
      reader_width_(g.sway_layers[2].outputs),
      driver_modulation_(arena.take<float>(driver_.modulation_room())),
      reader_modulation_(arena.take<float>(reader_.modulation_room())),
      drive_(arena.take<float>(g.sway_layers[0].inputs)),
      now_(arena.take<float>(joint_count_ + 3)),
      before_(arena.take<float>(joint_count_ + 3)),
      read_(arena.take<float>(g.sway_layers[2].inputs)),
      result_(arena.take<float>(outputs_)) {
  for (int k = 0; k < joint_count_; ++k) {
    const float lower = g.dof_lower[joints_[k]], upper = g.dof_upper[joints_[k]];
    middle_[k] = 0.5f * (lower + upper);
    half_[k] = 0.5f * (upper - lower);
  }
}

void LearntSway::shift(const float* shifts) noexcept {
  shifted_ = shifts != nullptr;
  if (!shifted_) return;
  std::copy_n(shifts, driver_width_, driver_modulation_ + driver_width_);
  std::copy_n(shifts + driver_width_, reader_width_, reader_modulation_ + reader_width_);
}

const float* LearntSway::added(const float* corrections, const float* positions, const float* bone_transforms,
                               const GarmentInput& input) noexcept {
  if (!(input.sway > 0)) {
    forget();
    return corrections;
  }
  for (int k = 0; k < joint_count_; ++k) {
    now_[k] =
        std::clamp((positions[joints_[k]] - middle_[k]) / half_[k], -kLargest, kLargest);  // rates are to be finite
  }
  std::copy_n(input.gravity, 3, now_ + joint_count_);
  begins_ = begins_ || input.elapsed < 0;
  if (begins_ || input.elapsed > 0) move(input);
  float* pose = read_ + 2 * oscillators_.count;
  for (int k = 0; k < joint_count_; ++k) pose[k] = std::clamp(now_[k], -kBeyond, kBeyond);
  std::copy_n(input.gravity, 3, pose + joint_count_);
  std::swap(now_, before_);
  const float* offsets = reader_.run(read_, shifted_ ? reader_modulation_ : nullptr);
  const float share = input.sway * hanging(bone_transforms);
  for (int k = 0; k < outputs_; ++k) result_[k] = corrections[k] + share * offsets[k];
  return result_;
}

float LearntSway::hanging(const float* bone_transforms) const noexcept {
  float least = 1, apart = 0;
  for (int k = 0; k < thigh_count_; ++k) {
    const float *along = bone_transforms + 12 * thighs_[k] + 2, *first = bone_transforms + 12 * thighs_[0] + 2;
    least = std::min(least, along[8]);
    apart = std::max(apart, std::hypot(along[0] - first[0], along[4] - first[4], along[8] - first[8]));
  }
  const float together = thigh_count_ > 1 ? smooth_step((kApart - apart) / (kApart - kTogether)) : 0.0f;
  return std::max(together, smooth_step((least - kLiesOn) / (kHangs - kLiesOn)));
}

void LearntSway::move(const GarmentInput& input) noexcept {
  const int count = joint_count_;
  const bool moves = !begins_ && input.moves > 0;
  if (!moves) std::copy_n(now_, count + 3, before_);
  float *rate = drive_ + count + 3, *v = rate + count, *w = v + 3;
  for (int k = 0; k < count + 3; ++k) drive_[k] = 0.5f * (now_[k] + before_[k]);
  for (int k = 0; k < count; ++k) {
    drive_[k] = std::clamp(drive_[k], -kBeyond, kBeyond);
    rate[k] = moves ? softly((double(now_[k]) - before_[k]) / input.elapsed, kLargestRate) / 3 : 0.0f;
  }
  float turning[3];
  for (int k = 0; k < 3; ++k) {
    v[k] = moves ? softly(input.velocity[k], kLargestVelocity) : 0.0f;
    turning[k] = moves ? softly(input.turning[k], kLargestTurning) : 0.0f;
    w[k] = turning[k] / 2;
    w[6 + k] = turning[k] * turning[k] / 8;
  }
  for (int k = 0; k < 3; ++k) {
    const int a = (k + 1) % 3, b = (k + 2) % 3;
    w[3 + k] = (turning[a] * v[b] - turning[b] * v[a]) / 4;
  }
  std::copy_n(drive_, 2 * count + 15, read_ + 2 * oscillators_.count + count + 3);
  const float* driven = driver_.run(drive_, shifted_ ? driver_modulation_ : nullptr);
  kernels_.oscillate(oscillators_, driven, begins_ ? -1 : std::min(input.elapsed, kLongestStep));
  begins_ = false;
  std::copy_n(oscillators_.real, oscillators_.count, read_);
  std::copy_n(oscillators_.imaginary, oscillators_.count, read_ + oscillators_.count);
}

}  // namespace physkin

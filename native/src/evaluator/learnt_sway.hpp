// The sway network of one garment: how its garment nodes lag, swing and settle.
//
// Oscillators are complex numbers x, driven by b and sped up by s, which the network makes of a frame's drive:
//
//     x' = s (-rate + i turn) (x - rest),    rest = b (rate + i turn) / |rate + i turn|
//
// solved in closed form, b and s being constant from frame to frame: whatever the rate of frames, nothing else depends
// on time. They forget by themselves; where the root is lost, cloth goes over to rest. The first frame begins there.
#pragma once

#include "evaluator/garment_input.hpp"
#include "evaluator/mlp.hpp"
#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"

namespace physkin {

// Of joint positions, scaled to [-1, 1] by their limits: what is farther out is taken as this far.
constexpr float kBeyond = 1.5f;
// [s] After that all oscillators are at rest, or near.
constexpr float kLongestStep = 1.0f;
// Of scaled joints [1/s], the root's velocity [m/s] and its turning [rad/s]: what the network sees is never as much.
constexpr double kLargestRate = 8, kLargestVelocity = 4, kLargestTurning = 8;

// Cloth lies on a raised thigh, and no longer sways as cloth that hangs: where the less upright of the two is turned from
// the vertical so far (cosine), nothing of its sway is left, and from the second on all of it.
constexpr float kLiesOn = 0.5f, kHangs = 0.85f;
// But thighs that are raised together carry it as one seat, from whose front it hangs: ends of unit vectors along thighs
// that are no farther apart than this leave all of its sway, those farther than the second nothing.
constexpr float kTogether = 0.3f, kApart = 0.6f;

class LearntSway {
 public:
  // Of a garment that has one. Layers that read joint positions and rates are packed in a precision of their own.
  LearntSway(const BoundGarment& garment, Precision of_inputs, Precision others, const Kernels& kernels, Arena& arena);

  // Shifts of the first hidden activations of both parts, as of BoundGarment::fabric_sway_shifts; null for none.
  void shift(const float* shifts) noexcept;

  // The next frame is the first one.
  void forget() noexcept { begins_ = true; }
  // Whether the last frame swayed.
  bool sways() const { return !begins_; }

  // The node deformer's corrections with what sways added, as much as the input says; valid until the next call.
  // positions (dofs) in radians, and what bones make of them. Gravity is effective gravity as it is given, of any length.
  const float* added(const float* corrections, const float* positions, const float* bone_transforms,
                     const GarmentInput& input) noexcept;

 private:
  void move(const GarmentInput& input) noexcept;
  float hanging(const float* bone_transforms) const noexcept;

  const Kernels& kernels_;
  int joint_count_, thigh_count_, outputs_;
  const std::int32_t *joints_, *thighs_;
  float *middle_, *half_;  // (joints) of their limits
  Oscillators oscillators_;
  Mlp driver_, reader_;
  int driver_width_, reader_width_;  // of their first hidden layers
  float *driver_modulation_, *reader_modulation_;
  bool shifted_ = false;
  float* drive_;          // (2 joints + 15)
  float *now_, *before_;  // (joints + 3) scaled joints and gravity
  float* read_;           // what the reader reads: states, real parts and then imaginary ones, pose, drive
  float* result_;         // (outputs)
  bool begins_ = true;
};

}  // namespace physkin

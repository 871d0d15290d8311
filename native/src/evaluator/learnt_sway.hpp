// The sway network of one garment: how its garment nodes lag, swing and settle. physkin_core/sway/learnt_sway.py is its
// readable twin.
#pragma once

#include "evaluator/mlp.hpp"
#include "evaluator/moment.hpp"
#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"

namespace physkin {

class LearntSway {
 public:
  // Of a garment that has one. Layers that read joint positions and rates are packed in a precision of their own.
  LearntSway(const BoundGarment& garment, Precision of_inputs, Precision others, const Kernels& kernels, Arena& arena);

  // The next frame is the first one.
  void forget() noexcept { begins_ = true; }

  // The node deformer's corrections with what sways added, as much as the moment says; valid until the next call.
  // positions (dofs) in radians; gravity (3), a unit direction.
  const float* added(const float* corrections, const float* positions, const float* gravity,
                     const Moment& moment) noexcept;

 private:
  void move(const Moment& moment) noexcept;

  const Kernels& kernels_;
  int joint_count_, outputs_;
  const std::int32_t* joints_;
  float *middle_, *half_;  // (joints) of their limits
  Oscillators oscillators_;
  Mlp driver_, reader_;
  float* drive_;          // (2 joints + 15)
  float *now_, *before_;  // (joints + 3) scaled joints and gravity
  float* read_;           // what the reader reads: states, real parts and then imaginary ones, pose, drive
  float* result_;         // (outputs)
  bool begins_ = true;
};

}  // namespace physkin

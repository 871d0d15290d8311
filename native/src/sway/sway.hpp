// From a root that moves to the gravity that networks take, and the moment; physkin_core/sway/sway.py is its readable twin.
#pragma once

#include "sway/pendulum.hpp"

namespace physkin {

class Sway {
 public:
  Sway() : pendulum_(PendulumSettings{}) {}

  // 0: cloth hangs as if nothing had moved, to 1: all of it.
  void set_amount(double amount) noexcept { amount_ = amount; }

  // Cloth hangs still, and nothing is known of the root.
  void reset() noexcept {
    pendulum_.reset();
    has_time_ = false;
  }

  // Moves the root (7), a position and a quaternion x, y, z, w, world <- root, then writes what Evaluator::step takes:
  // gravity (3) in its frame, in units of gravity for networks that know `accelerated` roots, else its direction, or that
  // of a root at rest for a garment that has `learnt` to sway; then a Moment's 11 numbers. What is wrong with time or
  // root, or null; nothing has changed then.
  const char* gravity(double time, const double* root, bool accelerated, bool learnt, float* out) noexcept;

 private:
  Pendulum pendulum_;
  double amount_ = 1;
  double time_ = 0;
  float passed_ = -1;
  bool has_time_ = false;
};

}  // namespace physkin

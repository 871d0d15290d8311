// The pendulum that stands for swinging cloth; physkin_core/sway/pendulum.py is its readable twin.
#pragma once

namespace physkin {

struct PendulumSettings {
  double frequency = 1.5;       // Hz, sideways
  double damping = 4.0;         // 1/s, sideways
  double gain = 3.5;            // sideways
  double lift_frequency = 5.0;  // Hz, along gravity, damped without overshoot
  double lift_gain = 1.0;
  double air_drag = 2.0;  // 1/s
};

class Pendulum {
 public:
  explicit Pendulum(const PendulumSettings& settings);

  // Cloth hangs still, and nothing is known of the root.
  void reset() noexcept;

  // The root is at position (3) [m] in the world at time [s]; both must be finite.
  void move(double time, const double* position) noexcept;

  // Moves the root (7), a position and a quaternion x, y, z, w, world <- root, then writes effective gravity (3) [m/s2]
  // in its frame. What is wrong with time or root, or null; nothing has changed then.
  const char* felt(double time, const double* root, double amount, double* out) noexcept;

 private:
  void felt_deflection(double* out) const noexcept;
  void swing(double passed, const double* equilibrium) noexcept;

  double frequency_[3], damping_[3], gain_[3], air_drag_;
  double deflection_[3], rate_[3];
  double time_, position_[3], velocity_[3];
  bool has_time_, has_velocity_;
};

}  // namespace physkin

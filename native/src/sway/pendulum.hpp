// The pendulum that stands for swinging cloth; physkin_core/sway/pendulum.py is its readable twin.
#pragma once

namespace physkin {

constexpr double kLargestGap = 0.25;  // [s] after that, what was before does not count

struct PendulumSettings {
  double frequency = 1.5;       // Hz, sideways
  double damping = 4.0;         // 1/s, sideways
  double gain = 3.5;            // sideways
  double lift_frequency = 5.0;  // Hz, along gravity, damped without overshoot
  double lift_gain = 1.0;
  double twist_damping = 7.0;  // 1/s, at the frequency of swinging sideways
  double air_drag = 2.0;  // 1/s
};

class Pendulum {
 public:
  explicit Pendulum(const PendulumSettings& settings);

  // Cloth hangs still, and nothing is known of the root.
  void reset() noexcept;

  // The root is at position (3) [m] in the world at time [s], turned by a unit quaternion (4); all must be finite.
  void move(double time, const double* position, const double* turn) noexcept;

  // Moves the root (7), a position and a quaternion x, y, z, w, world <- root, then writes effective gravity (3) [m/s2]
  // in its frame, and the twist [rad] about its vertical. What is wrong with time or root, or null; nothing has changed then.
  const char* felt(double time, const double* root, double amount, double* out) noexcept;

  // Writes velocity (3) [m/s] and turning (3) [rad/s] of the root from the pose before the last one to that, in its frame.
  // Whether they are known; after a gap or a jump they are not, and zero.
  bool motion(double* out) const noexcept;

 private:
  void felt_deflection(double* out) const noexcept;
  void swing(double passed, const double* equilibrium) noexcept;

  static constexpr int kAxes = 4;  // x, y, z [m] in the world, and about the root's vertical [rad]

  double frequency_[kAxes], damping_[kAxes], gain_[kAxes], air_drag_;
  double deflection_[kAxes], rate_[kAxes];
  double time_, position_[3], turn_[4], velocity_[kAxes], turning_[3];
  bool has_time_, has_velocity_;
};

}  // namespace physkin

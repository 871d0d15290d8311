// The pendulum that stands for swinging cloth, and what it tells of the root that moves it.
//
// Its deflection y [m/s2, world frame] is the acceleration that cloth seems to feel besides gravity. Sideways and along
// gravity, and as the twist [rad] of cloth about the root's vertical, each as an oscillator of its own,
//
//     y'' = -w^2 (y - y_eq) - D y',    y_eq = -gain (a + c v),
//
// v and a the velocity and acceleration of the root, c the drag of still air: under steady acceleration or at constant
// speed y ends at y_eq. Of a twist v is how fast the root turns, and the gain 1 / w^2: a torsion pendulum. Of a
// deflection that is hardly there less is felt, as cloth rubs at itself. The root moves on a straight line from one
// pose to the next, and turns steadily, so that its acceleration is a jump of v at each; between them the equation is
// solved in closed form, whatever time has passed: nothing depends on a rate.
#pragma once

#include <cmath>

namespace physkin {

constexpr double kStandardGravity = 9.81;  // [m/s2] what a direction of gravity stands for
constexpr double kLargestGap = 0.25;       // [s] after that, what was before does not count

// What is known of a root at one pose of it, for cloth that sways.
struct RootSample {
  double turn[4] = {0, 0, 0, 1};   // unit quaternion x, y, z, w, world <- root
  double gravity[3] = {0, 0, -1};  // unit direction in the root's frame
  double deflection[3] = {};       // [m/s2] in the world: what cloth feels besides gravity
  double twist = 0;                // [rad] of cloth round both legs, about the root's vertical
  // [m/s], [rad/s] from the pose before to this one, in the root's frame. After a gap or a jump they are not known, and
  // zero.
  double velocity[3] = {}, turning[3] = {};
  bool known = false;
};

class Pendulum {
 public:
  Pendulum();

  // Cloth hangs still, and nothing is known of the root.
  void reset() noexcept;

  // The root is at `root` (7), its position [m] in a world with Z up and its unit quaternion x, y, z, w, world <- root,
  // at `time` [s] of any clock. A time that came before changes nothing, or, where it lies back, begins anew from
  // there. What is wrong with time or root, or null; nothing has changed then.
  const char* move(double time, const double* root) noexcept;

  // As of the last move.
  RootSample sample() const noexcept;

 private:
  void advance(double time, const double* root, const double* turn) noexcept;
  void swing(double passed, const double* equilibrium) noexcept;

  static constexpr int kAxes = 4;  // x, y, z [m] in the world, and about the root's vertical [rad]

  double frequency_[kAxes], damping_[kAxes], gain_[kAxes];
  double deflection_[kAxes], rate_[kAxes];
  double time_, position_[3], turn_[4], velocity_[kAxes], turning_[3];
  float gravity_[3];
  bool has_time_, has_velocity_;
};

// Of a vector (3). std::hypot of three is 0 where two are and the third is no number.
inline double length_of(const double* v) noexcept { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

// A vector (3) of the world in the frame of a root with that turn.
void carry_back(const double* turn, const double* v, double* out) noexcept;

}  // namespace physkin

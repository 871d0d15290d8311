// What is known of a root that moves, pose by pose: where down is, how fast it moves and turns. Whatever rate poses have.
#pragma once

#include <cmath>

namespace physkin {

constexpr double kStandardGravity = 9.81;  // [m/s2] what a direction of gravity stands for
constexpr double kLargestGap = 0.25;       // [s] after that, what was before does not count

// What is known of a root at one pose of it, for cloth that sways.
struct RootSample {
  double turn[4] = {0, 0, 0, 1};   // unit quaternion x, y, z, w, world <- root
  double gravity[3] = {0, 0, -1};  // unit direction in the root's frame
  // [m/s], [rad/s] from the pose before to this one, in the root's frame. After a gap or a jump they are not known, and
  // zero.
  double velocity[3] = {}, turning[3] = {};
  bool known = false;
};

class RootTracker {
 public:
  // Nothing is known of the root.
  void reset() noexcept { *this = RootTracker(); }

  // The root is at `root` (7), its position [m] in a world with Z up and its unit quaternion x, y, z, w, world <- root,
  // at `time` [s] of any clock. A time that came before changes nothing, or, where it lies back, begins anew from
  // there. What is wrong with time or root, or null; nothing has changed then.
  const char* move(double time, const double* root) noexcept;

  // As of the last move.
  RootSample sample() const noexcept;

 private:
  void advance(double time, const double* root, const double* turn) noexcept;

  double time_ = 0, position_[3] = {}, turn_[4] = {0, 0, 0, 1};
  double velocity_[3] = {}, turning_[3] = {};  // in the world, in the root's frame
  float gravity_[3] = {0, 0, -1};
  bool has_time_ = false, has_velocity_ = false;
};

// Of a vector (3). std::hypot of three is 0 where two are and the third is no number.
inline double length_of(const double* v) noexcept { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

// A vector (3) of the world in the frame of a root with that turn.
void carry_back(const double* turn, const double* v, double* out) noexcept;

}  // namespace physkin

#include "sway/root_tracker.hpp"

#include <algorithm>

namespace physkin {
namespace {

// [m/s], [rad/s] A change of velocity or turning from pose to pose beyond these is a jump of the root, not a motion.
constexpr double kLargestChange = 8.0, kLargestChangeOfTurning = 20.0;
constexpr double kFarthest = 1e9;  // [m] that the root may be from the world's origin

// Rotation vector (3) in the root's frame, by which it has turned between two unit quaternions.
void rotation(const double* before, const double* after, double* out) {
  const double x = after[0], y = after[1], z = after[2], w = after[3];
  const double a = before[0], b = before[1], c = before[2], d = before[3];
  const double axis[3] = {d * x - w * a - b * z + c * y, d * y - w * b - c * x + a * z, d * z - w * c - a * y + b * x};
  const double cosine = d * w + a * x + b * y + c * z, length = length_of(axis);
  const double angle = std::copysign(2.0, cosine) * std::atan2(length, std::abs(cosine)) / std::max(length, 1e-12);
  for (int k = 0; k < 3; ++k) out[k] = angle * axis[k];
}

// Direction of gravity in the frame of a root (7), in the precision that networks know it.
void gravity_in(const double* root, float* out) {
  const double x = float(root[3]), y = float(root[4]), z = float(root[5]), w = float(root[6]);
  out[0] = float(2 * (w * y - x * z));
  out[1] = float(-2 * (w * x + y * z));
  out[2] = float(2 * (x * x + y * y) - 1);
}

}  // namespace

void carry_back(const double* turn, const double* v, double* out) noexcept {
  const double x = turn[0], y = turn[1], z = turn[2], w = turn[3];
  const double p = y * v[2] - z * v[1], q = z * v[0] - x * v[2], r = x * v[1] - y * v[0];  // axis x v
  out[0] = v[0] + 2 * (y * r - z * q) - 2 * w * p;
  out[1] = v[1] + 2 * (z * p - x * r) - 2 * w * q;
  out[2] = v[2] + 2 * (x * q - y * p) - 2 * w * r;
}

void RootTracker::advance(double time, const double* root, const double* turn) noexcept {
  if (has_time_ && time == time_) return;
  const double passed = time - time_;
  bool known = has_time_ && passed > 0 && passed <= kLargestGap;
  double velocity[3], turning[3];
  if (known) {
    rotation(turn_, turn, turning);
    double change[3], change_of_turning[3];
    for (int k = 0; k < 3; ++k) {
      velocity[k] = (root[k] - position_[k]) / passed;
      turning[k] /= passed;
      change[k] = velocity[k] - velocity_[k];
      change_of_turning[k] = turning[k] - turning_[k];
    }
    known = !has_velocity_ ||
            (length_of(change) <= kLargestChange && length_of(change_of_turning) <= kLargestChangeOfTurning);
  }
  if (known) {
    std::copy_n(velocity, 3, velocity_);
    std::copy_n(turning, 3, turning_);
  }
  time_ = time;
  has_time_ = true;
  has_velocity_ = known;
  std::copy_n(root, 3, position_);
  std::copy_n(turn, 4, turn_);
  gravity_in(root, gravity_);
}

const char* RootTracker::move(double time, const double* root) noexcept {
  bool finite = std::isfinite(time);
  for (int k = 0; k < 7; ++k) finite = finite && std::isfinite(root[k]);
  if (!finite) return "time and root must be finite, root x, y, z and a quaternion x, y, z, w";
  const double length = std::hypot(length_of(root + 3), root[6]);
  if (!(std::abs(length - 1) <= 0.01)) return "the quaternion of root must be of length 1";
  for (int k = 0; k < 3; ++k) {
    if (std::abs(root[k]) > kFarthest) return "the root must be within 1e+09 m";
  }
  const double turn[4] = {root[3] / length, root[4] / length, root[5] / length, root[6] / length};
  advance(time, root, turn);
  return nullptr;
}

RootSample RootTracker::sample() const noexcept {
  RootSample s;
  std::copy_n(turn_, 4, s.turn);
  const double length = std::hypot(double(gravity_[0]), double(gravity_[1]), double(gravity_[2]));
  for (int k = 0; k < 3; ++k) s.gravity[k] = gravity_[k] / length;
  s.known = has_velocity_;
  if (s.known) {
    carry_back(turn_, velocity_, s.velocity);
    std::copy_n(turning_, 3, s.turning);
  }
  return s;
}

}  // namespace physkin

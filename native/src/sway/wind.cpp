#include "sway/wind.hpp"

#include <algorithm>
#include <cmath>

#include "sway/root_tracker.hpp"

namespace physkin {

const char* Wind::set(const double* velocity) noexcept {
  if (!(length_of(velocity) <= kLargestWind)) return "wind must be (3,), finite, up to 13 m/s";
  std::copy_n(velocity, 3, velocity_);
  return nullptr;
}

void Wind::face(const double* turn) noexcept {
  std::copy_n(turn, 4, turn_);
  left_out_ = false;
}

void Wind::face_level(const double* direction) noexcept {
  const double turn[4] = {-direction[1], direction[0], 0, 1 - direction[2]};
  const double length = std::sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[3] * turn[3]);
  const double upside_down[4] = {1, 0, 0, 0};  // all ways are as short: about the axis along which it faces
  if (length < 1e-6) return face(upside_down);
  const double unit[4] = {turn[0] / length, turn[1] / length, 0, turn[3] / length};
  face(unit);
}

void Wind::blow(double seconds) noexcept {
  double change[3];
  for (int k = 0; k < 3; ++k) change[k] = velocity_[k] - blowing_[k];
  const double most = seconds < 0 ? kLargestWind * 2 : kFastestGust * seconds;
  const double share = std::min(1.0, most / std::max(length_of(change), 1e-9));
  for (int k = 0; k < 3; ++k) blowing_[k] = share < 1 ? blowing_[k] + share * change[k] : velocity_[k];
  double wind[3];
  carry_back(turn_, blowing_, wind);
  for (int k = 0; k < 3; ++k) pull_[k] = left_out_ ? 0 : kAirDrag / kStandardGravity * wind[k];
}

void Wind::add_to(float* gravity) const noexcept {
  if (pull_[0] == 0 && pull_[1] == 0 && pull_[2] == 0) return;
  double felt[3];
  for (int k = 0; k < 3; ++k) felt[k] = gravity[k] + pull_[k];
  const double shrink = std::min(1.0, kLargestFelt / std::max(length_of(felt), 1e-9));
  for (int k = 0; k < 3; ++k) gravity[k] = float(shrink * felt[k]);
}

}  // namespace physkin

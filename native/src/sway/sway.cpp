#include "sway/sway.hpp"

#include <cmath>

namespace physkin {
namespace {

constexpr double kGravity = 9.81;
constexpr double kLeastDirected = 2.0;  // [m/s2] of less the direction alone says nothing

// Direction of gravity in the frame of a root (7) that stands still.
void gravity_at(const double* root, double* out) {
  const float x = float(root[3]), y = float(root[4]), z = float(root[5]), w = float(root[6]);
  out[0] = 2 * (w * y - x * z);
  out[1] = -2 * (w * x + y * z);
  out[2] = 2 * (x * x + y * y) - 1;
}

}  // namespace

const char* Sway::gravity(double time, const double* root, bool accelerated, float* out) noexcept {
  double felt[4];
  if (const char* wrong = pendulum_.felt(time, root, amount_, felt)) return wrong;
  double length = std::sqrt(felt[0] * felt[0] + felt[1] * felt[1] + felt[2] * felt[2]);
  if (amount_ > 0 && accelerated) {
    length = kGravity;
  } else if (!(amount_ > 0 && length > kLeastDirected)) {
    gravity_at(root, felt);
    length = std::sqrt(felt[0] * felt[0] + felt[1] * felt[1] + felt[2] * felt[2]);
  }
  for (int k = 0; k < 3; ++k) out[k] = float(felt[k] / length);
  out[3] = float(felt[3]);
  if (!has_time_ || time != time_) {
    const double passed = time - time_;
    passed_ = has_time_ && passed > 0 && passed <= kLargestGap ? float(passed) : -1.0f;
    time_ = time;
    has_time_ = true;
  }
  out[4] = amount_ > 0 ? passed_ : -1.0f;
  return nullptr;
}

}  // namespace physkin

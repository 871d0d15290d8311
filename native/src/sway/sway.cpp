#include "sway/sway.hpp"

#include <algorithm>
#include <cmath>

namespace physkin {
namespace {

constexpr double kGravity = 9.81;
constexpr double kLeastDirected = 2.0;  // [m/s2] of less the direction alone says nothing
constexpr double kFastest = 1e6;        // [m/s, rad/s] of a root

// Direction of gravity in the frame of a root (7) that stands still.
void gravity_at(const double* root, double* out) {
  const float x = float(root[3]), y = float(root[4]), z = float(root[5]), w = float(root[6]);
  out[0] = 2 * (w * y - x * z);
  out[1] = -2 * (w * x + y * z);
  out[2] = 2 * (x * x + y * y) - 1;
}

}  // namespace

const char* Sway::gravity(double time, const double* root, bool accelerated, bool learnt, float* out) noexcept {
  double felt[4];
  if (const char* wrong = pendulum_.felt(time, root, amount_, felt)) return wrong;
  double length = std::sqrt(felt[0] * felt[0] + felt[1] * felt[1] + felt[2] * felt[2]);
  const bool swings = amount_ > 0 && !learnt;
  if (swings && accelerated) {
    length = kGravity;
  } else if (!(swings && length > kLeastDirected)) {
    gravity_at(root, felt);
    length = std::sqrt(felt[0] * felt[0] + felt[1] * felt[1] + felt[2] * felt[2]);
  }
  for (int k = 0; k < 3; ++k) out[k] = float(felt[k] / length);
  const double passed = time - time_;
  const float elapsed = has_time_ ? float(std::max(passed, 0.0)) : -1.0f;
  if (!has_time_ || passed != 0) {
    passed_ = has_time_ && passed > 0 && passed <= kLargestGap ? float(passed) : -1.0f;
    time_ = time;
    has_time_ = true;
  }
  double motion[6];
  const bool known = pendulum_.motion(motion);
  out[3] = swings ? float(felt[3]) : 0.0f;
  out[4] = amount_ > 0 ? passed_ : -1.0f;
  out[5] = learnt ? float(amount_) : 0.0f;
  out[6] = elapsed;
  out[7] = known && passed_ >= 0 ? 1.0f : 0.0f;
  for (int k = 0; k < 6; ++k) out[8 + k] = float(std::clamp(motion[k], -kFastest, kFastest));
  return nullptr;
}

}  // namespace physkin

#include "sway/pendulum.hpp"

#include <algorithm>
#include <cmath>

namespace physkin {
namespace {

constexpr double kPi = 3.14159265358979323846;

// Fitted to simulated skirts and dresses by least squares; the gain is above 1 as drapes lean less under effective
// gravity than simulated cloth. The drag of air is that of the simulation.
constexpr double kFrequency = 1.5;      // Hz, sideways
constexpr double kDamping = 4.0;        // 1/s, sideways
constexpr double kGain = 3.5;           // sideways
constexpr double kLiftFrequency = 5.0;  // Hz, along gravity, damped without overshoot
constexpr double kLiftGain = 1.0;
constexpr double kTwistDamping = 7.0;  // 1/s, at the frequency of swinging sideways
constexpr double kAirDrag = 2.0;       // 1/s

// [m/s], [rad/s] A change of velocity or turning from pose to pose beyond these is a jump of the root, not a motion.
constexpr double kLargestChange = 8.0, kLargestChangeOfTurning = 20.0;
constexpr double kLargestTwist = 0.8;                        // [rad] what the twist never reaches
constexpr double kLargestDeflection = 2 * kStandardGravity;  // [m/s2] what the deflection that is felt never reaches
constexpr double kLeastDeflection = 0.25;  // [m/s2] of this size half is felt, of smaller ones the less
constexpr double kFarthest = 1e9;          // [m] that the root may be from the world's origin

double squared(const double* v) { return v[0] * v[0] + v[1] * v[1] + v[2] * v[2]; }

// Rotation vector (3) in the root's frame, by which it has turned between two unit quaternions.
void rotation(const double* before, const double* after, double* out) {
  const double x = after[0], y = after[1], z = after[2], w = after[3];
  const double a = before[0], b = before[1], c = before[2], d = before[3];
  const double axis[3] = {d * x - w * a - b * z + c * y, d * y - w * b - c * x + a * z, d * z - w * c - a * y + b * x};
  const double cosine = d * w + a * x + b * y + c * z, length = std::sqrt(squared(axis));
  const double angle = std::copysign(2.0, cosine) * std::atan2(length, std::abs(cosine)) / std::max(length, 1e-12);
  for (int k = 0; k < 3; ++k) out[k] = angle * axis[k];
}

// How far the vertical of a root is that of the world, 0 to 1.
double upright(const double* turn) { return std::max(0.0, 1 - 2 * (turn[0] * turn[0] + turn[1] * turn[1])); }

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

Pendulum::Pendulum() {
  const double sideways = 2 * kPi * kFrequency, along = 2 * kPi * kLiftFrequency;
  for (int k = 0; k < 3; ++k) {
    frequency_[k] = k < 2 ? sideways : along;
    damping_[k] = k < 2 ? kDamping : 2 * along;
    gain_[k] = k < 2 ? kGain : kLiftGain;
  }
  frequency_[3] = sideways;
  damping_[3] = kTwistDamping;
  gain_[3] = 1 / (sideways * sideways);
  reset();
}

void Pendulum::reset() noexcept {
  std::fill_n(deflection_, kAxes, 0.0);
  std::fill_n(rate_, kAxes, 0.0);
  std::fill_n(position_, 3, 0.0);
  std::fill_n(turn_, 4, 0.0);
  turn_[3] = 1;
  gravity_[0] = gravity_[1] = 0;
  gravity_[2] = -1;
  std::fill_n(velocity_, kAxes, 0.0);
  std::fill_n(turning_, 3, 0.0);
  time_ = 0;
  has_time_ = has_velocity_ = false;
}

void Pendulum::advance(double time, const double* root, const double* turn) noexcept {
  const double* position = root;
  if (has_time_ && time == time_) return;
  const bool had_time = has_time_;
  const double passed = time - time_;
  time_ = time;
  has_time_ = true;
  double velocity[kAxes], change[kAxes], equilibrium[kAxes] = {0, 0, 0, 0};
  bool known = had_time && passed > 0 && passed <= kLargestGap;
  if (known) {
    rotation(turn_, turn, turning_);
    for (double& rate : turning_) rate /= passed;
    for (int k = 0; k < kAxes; ++k) {
      velocity[k] = k < 3 ? (position[k] - position_[k]) / passed : turning_[2] * upright(turn);
      change[k] = velocity[k] - velocity_[k];
    }
    known = !has_velocity_ ||
            (squared(change) <= kLargestChange * kLargestChange && std::abs(change[3]) <= kLargestChangeOfTurning);
  }
  std::copy_n(position, 3, position_);
  std::copy_n(turn, 4, turn_);
  gravity_in(root, gravity_);
  if (known) {
    for (int k = 0; k < kAxes; ++k) {
      if (has_velocity_) rate_[k] -= gain_[k] * frequency_[k] * frequency_[k] * change[k];
      equilibrium[k] = -gain_[k] * kAirDrag * velocity[k];
      velocity_[k] = velocity[k];
    }
  }
  has_velocity_ = known;
  if (had_time && passed > 0) swing(passed, equilibrium);
}

void Pendulum::swing(double passed, const double* equilibrium) noexcept {
  for (int k = 0; k < kAxes; ++k) {
    const double half = damping_[k] / 2, square = frequency_[k] * frequency_[k] - half * half;
    const double root = std::sqrt(std::abs(square));
    double cosine, sine;
    if (square > 0) {
      const double decay = std::exp(-half * passed);
      cosine = decay * std::cos(root * passed);
      sine = decay * std::sin(root * passed) / std::max(root, 1e-9);
    } else {  // the decay is inside, as cosh alone overflows
      const double slow = std::exp(-(half - root) * passed), fast = std::exp(-(half + root) * passed);
      cosine = (slow + fast) / 2;
      sine = (slow - fast) / (2 * std::max(root, 1e-9));
    }
    if (root * passed < 1e-6) sine = std::exp(-half * passed) * passed;
    const double away = deflection_[k] - equilibrium[k], rate = rate_[k];
    deflection_[k] = (cosine + half * sine) * away + sine * rate + equilibrium[k];
    rate_[k] = -frequency_[k] * frequency_[k] * sine * away + (cosine - half * sine) * rate;
  }
}

const char* Pendulum::move(double time, const double* root) noexcept {
  bool finite = std::isfinite(time);
  for (int k = 0; k < 7; ++k) finite = finite && std::isfinite(root[k]);
  if (!finite) return "time and root must be finite, root x, y, z and a quaternion x, y, z, w";
  const double length = std::sqrt(squared(root + 3) + root[6] * root[6]);
  if (!(std::abs(length - 1) <= 0.01)) return "the quaternion of root must be of length 1";
  for (int k = 0; k < 3; ++k) {
    if (std::abs(root[k]) > kFarthest) return "the root must be within 1e+09 m";
  }
  const double turn[4] = {root[3] / length, root[4] / length, root[5] / length, root[6] / length};
  advance(time, root, turn);
  return nullptr;
}

RootSample Pendulum::sample() const noexcept {
  RootSample s;
  std::copy_n(turn_, 4, s.turn);
  const double length = std::hypot(double(gravity_[0]), double(gravity_[1]), double(gravity_[2]));
  for (int k = 0; k < 3; ++k) s.gravity[k] = gravity_[k] / length;
  const double square = squared(deflection_), twist = deflection_[3];
  const double share = square / (square + kLeastDeflection * kLeastDeflection);
  const double scale = share / std::sqrt(1 + square / (kLargestDeflection * kLargestDeflection));
  for (int k = 0; k < 3; ++k) s.deflection[k] = deflection_[k] * scale;
  s.twist = twist / std::sqrt(1 + twist * twist / (kLargestTwist * kLargestTwist));
  s.known = has_velocity_;
  if (s.known) {
    carry_back(turn_, velocity_, s.velocity);
    std::copy_n(turning_, 3, s.turning);
  }
  return s;
}

}  // namespace physkin

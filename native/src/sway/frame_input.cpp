#include "sway/frame_input.hpp"

#include <algorithm>
#include <cmath>

namespace physkin {
namespace {

// What is left when nothing but gravity is known.
GarmentInput under(const double* gravity) {
  GarmentInput row;
  for (int k = 0; k < 3; ++k) row.gravity[k] = float(gravity[k]);
  return row;
}

}  // namespace

void FrameInput::reset() noexcept {
  root_.reset();
  has_time_ = false;
  passed_ = -1;
}

const char* FrameInput::hang(const double* direction) noexcept {
  if (!(std::abs(length_of(direction) - 1) <= 1e-3)) return "gravity must be a unit direction (3,)";
  std::fill(rows_.begin(), rows_.end(), under(direction));
  rates_known_ = true;
  wind_.face_level(direction);
  return nullptr;
}

const char* FrameInput::accelerate(const double* effective_gravity, const double* at_rest) noexcept {
  const double* felt = effective_gravity;
  if (!(length_of(felt) <= kLargestEffectiveGravity * kStandardGravity)) {
    return "effective_gravity must be (3,), finite, up to 29.4 m/s2 long";
  }
  for (std::size_t k = 0; k < rows_.size(); ++k) {
    double own[3];
    for (int axis = 0; axis < 3; ++axis) {
      const double start = at_rest == nullptr ? 0 : at_rest[axis], share = at_rest == nullptr ? 1 : sways_[k];
      own[axis] = (start + share * (felt[axis] - start)) / kStandardGravity;
    }
    rows_[k] = under(own);
  }
  rates_known_ = true;
  if (at_rest == nullptr) {
    wind_.leave_out();
  } else {
    const double down = std::max(length_of(at_rest), 1e-9);
    const double direction[3] = {at_rest[0] / down, at_rest[1] / down, at_rest[2] / down};
    wind_.face_level(direction);
  }
  return nullptr;
}

void FrameInput::follow(const RootSample& root) noexcept {
  GarmentInput row = under(root.gravity);
  for (int axis = 0; axis < 3; ++axis) {
    row.velocity[axis] = float(std::clamp(root.velocity[axis], -kFastest, kFastest));
    row.turning[axis] = float(std::clamp(root.turning[axis], -kFastest, kFastest));
  }
  std::fill(rows_.begin(), rows_.end(), row);
  rates_known_ = root.known;
  wind_.face(root.turn);
}

const char* FrameInput::move(double time, const double* root) noexcept {
  if (const char* wrong = root_.move(time, root)) return wrong;
  follow(root_.sample());
  return nullptr;
}

const char* FrameInput::begin_frame(double time) noexcept {
  if (!std::isfinite(time)) return "time must be finite";
  const double passed = time - time_;
  const float elapsed = has_time_ ? float(std::max(passed, 0.0)) : -1.0f;
  if (!has_time_ || passed != 0) {
    passed_ = has_time_ && passed > 0 && passed <= kLargestGap ? float(passed) : -1.0f;
    time_ = time;
    has_time_ = true;
  }
  for (std::size_t k = 0; k < rows_.size(); ++k) {
    GarmentInput& row = rows_[k];
    const bool swings = sways_[k] > 0;
    row.passed = swings ? passed_ : -1;
    row.sway = float(sways_[k]);
    row.elapsed = swings ? elapsed : -1;
    row.moves = swings && rates_known_ && passed_ >= 0 ? 1.0f : 0.0f;
  }
  blow(elapsed);
  return nullptr;
}

void FrameInput::begin_still_frame() noexcept {
  reset();
  for (GarmentInput& row : rows_) {
    row.passed = kStandsAlone;
    row.elapsed = -1;
    row.sway = row.moves = 0;
  }
  blow(-1);
}

void FrameInput::blow(double seconds) noexcept {
  wind_.blow(seconds);
  for (GarmentInput& row : rows_) wind_.add_to(row.gravity);
}

}  // namespace physkin

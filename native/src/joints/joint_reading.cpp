#include "joints/joint_reading.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <utility>

namespace physkin {
namespace {

double load(const unsigned char* bytes, bool swapped) {
  unsigned char ordered[sizeof(double)];
  std::memcpy(ordered, bytes, sizeof ordered);
  if (swapped) std::reverse(ordered, ordered + sizeof ordered);
  double value;
  std::memcpy(&value, ordered, sizeof value);
  return value;
}

// Whether every position is within `farthest` [rad] of zero; not so for what is not finite.
bool ordinary(const float* positions, std::size_t count, float farthest) {
  bool all = true;
  for (std::size_t k = 0; k < count; ++k) all &= std::abs(positions[k]) <= farthest;  // false for NaN
  return all;
}

}  // namespace

JointReading::JointReading(std::vector<TakenJoint> taken, std::size_t first, bool swapped, double farthest,
                           std::size_t dofs)
    : taken_(std::move(taken)),
      positions_(taken_.size()),
      first_(first),
      end_(first),
      swapped_(swapped),
      farthest_(float(farthest)),
      dofs_(dofs) {
  for (const TakenJoint& joint : taken_) {
    end_ = std::max(end_, first + sizeof(double) * (std::size_t(joint.source) + 1));
  }
}

bool JointReading::read(const unsigned char* message, std::size_t size, const float* start, float* out) {
  if (size < end_) return false;
  const unsigned char* values = message + first_;
  for (std::size_t k = 0; k < taken_.size(); ++k) {
    const TakenJoint& joint = taken_[k];
    const double value = load(values + sizeof(double) * std::size_t(joint.source), swapped_);
    positions_[k] = float(joint.scale * value + joint.offset);
  }
  if (!ordinary(positions_.data(), positions_.size(), farthest_)) return false;
  std::copy(start, start + dofs_, out);
  for (std::size_t k = 0; k < taken_.size(); ++k) out[taken_[k].target] = positions_[k];
  return true;
}

bool begins_with(const unsigned char* message, std::size_t size, const unsigned char* pattern,
                 const unsigned char* mask, std::size_t count) {
  if (size < count) return false;
  unsigned char differing = 0;
  for (std::size_t k = 0; k < count; ++k) differing |= (message[k] ^ pattern[k]) & mask[k];
  return differing == 0;
}

void widen(const float* positions, float* least, float* most, std::size_t count) {
  for (std::size_t k = 0; k < count; ++k) {
    least[k] = std::min(least[k], positions[k]);
    most[k] = std::max(most[k], positions[k]);
  }
}

}  // namespace physkin

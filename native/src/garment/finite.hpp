// Search for values that are not finite or absurdly large, and what is said of them.
#pragma once

#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>

namespace physkin {

// No length [m], angle or network weight of a garment comes near, and nothing computed from smaller ones overflows.
constexpr float kLargest = 1e6f;

// Index of the first value with |value| > limit or NaN; count if there is none.
inline std::size_t first_beyond(const float* values, std::size_t count, float limit) {
  // Every comparison is one that a NaN fails. The first loop has no early exit, so that it runs in vector registers.
  int bad = 0;
  for (std::size_t i = 0; i < count; ++i) bad |= !(std::fabs(values[i]) <= limit);
  if (!bad) return count;
  std::size_t i = 0;
  while (std::fabs(values[i]) <= limit) ++i;
  return i;
}

// The first value that is not finite, or beyond the limit of what it stands for; converts to false if there is none.
struct Rejection {
  const char* name = nullptr;
  std::size_t index = 0;
  float value = 0.0f, limit = 0.0f;

  explicit operator bool() const { return name != nullptr; }

  std::string message() const {
    return std::string(name) + "[" + std::to_string(index) + "] is " + std::to_string(value) +
           "; every value must be finite and within +-" + std::to_string(limit);
  }
};

inline Rejection reject_beyond(const char* name, const float* values, std::size_t count, float limit) {
  const std::size_t bad = first_beyond(values, count, limit);
  return bad < count ? Rejection{name, bad, values[bad], limit} : Rejection{};
}

// The same as an exception, std::invalid_argument.
inline void check_finite(const std::string& name, const float* values, std::size_t count, float limit = kLargest) {
  if (const Rejection bad = reject_beyond(name.c_str(), values, count, limit))
    throw std::invalid_argument(bad.message());
}

}  // namespace physkin

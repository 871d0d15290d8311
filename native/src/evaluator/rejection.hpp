// Why a frame was refused.
#pragma once

#include <cstddef>
#include <string>

#include "garment/finite.hpp"

namespace physkin {

// Metres; far beyond any garment, and small enough that nothing computed from it overflows.
constexpr float kLargestLength = 1e6f;

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

}  // namespace physkin

// Checks of index arrays that a frame follows blindly. Each throws std::invalid_argument and names the value.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>

namespace physkin {

inline void check_indices(const char* name, const std::int32_t* values, std::size_t count, int limit) {
  for (std::size_t i = 0; i < count; ++i) {
    if (values[i] >= 0 && values[i] < limit) continue;
    throw std::invalid_argument(std::string(name) + "[" + std::to_string(i) + "] is " + std::to_string(values[i]) +
                                "; must be in [0, " + std::to_string(limit) + ")");
  }
}

// Where each of `items` lists starts in an array of `size`, and where the last one ends.
inline void check_starts(const char* name, const std::int32_t* starts, int count, int items, int size) {
  bool good = count == items + 1 && starts[0] == 0 && starts[items] == size;
  for (int i = 0; good && i < items; ++i) good = starts[i] <= starts[i + 1];
  if (good) return;
  throw std::invalid_argument(std::string(name) + " must be " + std::to_string(items + 1) +
                              " values that rise from 0 to " + std::to_string(size));
}

}  // namespace physkin

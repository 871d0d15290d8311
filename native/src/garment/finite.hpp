// Search for values that are not finite or absurdly large.
#pragma once

#include <cmath>
#include <cstddef>

namespace physkin {

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

}  // namespace physkin

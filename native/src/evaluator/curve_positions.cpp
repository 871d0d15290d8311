#include "evaluator/curve_positions.hpp"

#include <algorithm>

namespace physkin {

std::vector<std::uint32_t> curve_positions(const float* points, int count) {
  constexpr int kBits = 10;
  constexpr float kCells = 1 << kBits;
  float low[3], extent = 0.0f;
  for (int c = 0; c < 3; ++c) {
    float high = low[c] = points[c];
    for (int i = 1; i < count; ++i) {
      low[c] = std::min(low[c], points[3 * i + c]);
      high = std::max(high, points[3 * i + c]);
    }
    extent = std::max(extent, high - low[c]);
  }
  std::vector<std::uint32_t> positions(count);
  for (std::size_t i = 0; i < 3 * std::size_t(count); ++i) {
    const float cell = (points[i] - low[i % 3]) / extent * kCells;
    const std::uint32_t bits = cell > 0.0f ? std::uint32_t(std::min(cell, kCells - 1.0f)) : 0;  // 0 / 0 is none
    for (int bit = 0; bit < kBits; ++bit) positions[i / 3] |= (bits >> bit & 1u) << (3 * bit + int(i % 3));
  }
  return positions;
}

}  // namespace physkin

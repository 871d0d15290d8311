// An order of points in which neighbours follow each other.
#pragma once

#include <cstdint>
#include <vector>

namespace physkin {

// Positions of points (count, 3) along a curve that keeps neighbours together (Morton): the bits of the three
// coordinates in turn.
std::vector<std::uint32_t> curve_positions(const float* points, int count);

}  // namespace physkin

// An order of points in which neighbours follow each other.
#pragma once

#include <cstdint>
#include <vector>

#include "garment/bound_garment.hpp"

namespace physkin {

// Positions of points (count, 3) along a curve that keeps neighbours together (Morton): the bits of the three
// coordinates in turn.
std::vector<std::uint32_t> curve_positions(const float* points, int count);

// The same of a garment's vertices, by the garment nodes that they go with: by steps from node to node, from nodes that
// are far from each other. So it is the same on all bodies.
std::vector<std::uint32_t> curve_positions(const SkinningData& garment);

}  // namespace physkin

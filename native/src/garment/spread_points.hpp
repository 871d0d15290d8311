// Points that lie far from each other.
#pragma once

#include <cstdint>

namespace physkin {

// Chooses `chosen_count` of points (count, width), each the farthest from those chosen before, the first one first. It is
// fast where neighbours follow each other in the order of points.
void spread_points(const double* points, int count, int width, std::int32_t* chosen, int chosen_count);

}  // namespace physkin

// A tucked hem: physkin_core/outfit/tuck.py says what it does, and does the same.
#pragma once

#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

constexpr int kAnchorCorners = 3, kDrawnFrom = 4;

// Fields as in Tuck of physkin_core/outfit/tuck.py. Views, read during construction only.
struct TuckData {
  int held_count = -1, drawn_count = -1;
  const std::int32_t* held = nullptr;
  const std::int32_t* anchor = nullptr;
  const float* anchor_share = nullptr;
  const std::int32_t* drawn = nullptr;
  const std::int32_t* drawn_by = nullptr;
  const float* drawn_share = nullptr;
};

TuckData read_tuck(FieldSource& source);

class Tuck {
 public:
  // Copies into the arena. Throws std::invalid_argument where an index is out of range or a value is not finite.
  Tuck(const TuckData& data, int inner_vertices, int outer_vertices, Arena& arena);

  // Moves the tucked layer's positions; rows of both must have normals. Allocates nothing.
  void apply(const VertexRows& inner, const VertexRows& outer) noexcept;

 private:
  int held_count_, drawn_count_;
  const std::int32_t* held_;
  const std::int32_t* anchor_;
  const float* anchor_share_;
  const std::int32_t* drawn_;
  const std::int32_t* drawn_by_;
  const float* drawn_share_;
  float* displacement_;  // (held_count_, 3) [m]
};

}  // namespace physkin

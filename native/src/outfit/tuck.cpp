#include "outfit/tuck.hpp"

#include "garment/finite.hpp"
#include "outfit/checks.hpp"
#include "outfit/cloth_point.hpp"

namespace physkin {
namespace {

constexpr float kInset = 0.003f;  // [m] as INSET of tuck.py

}  // namespace

TuckData read_tuck(FieldSource& source) {
  TuckData d;
  std::vector<int> held{-1}, corners{-1, kAnchorCorners}, drawn{-1}, from{-1, kDrawnFrom};
  d.held = source.integers("held", held);
  corners[0] = d.held_count = held[0];
  d.anchor = source.integers("anchor", corners);
  d.anchor_share = source.floats("anchor_share", corners);
  d.drawn = source.integers("drawn", drawn);
  from[0] = d.drawn_count = drawn[0];
  d.drawn_by = source.integers("drawn_by", from);
  d.drawn_share = source.floats("drawn_share", from);
  return d;
}

Tuck::Tuck(const TuckData& d, int inner_vertices, int outer_vertices, Arena& arena)
    : held_count_(d.held_count), drawn_count_(d.drawn_count) {
  const std::size_t corners = std::size_t(kAnchorCorners) * d.held_count, from = std::size_t(kDrawnFrom) * d.drawn_count;
  check_indices("held", d.held, d.held_count, inner_vertices);
  check_indices("anchor", d.anchor, corners, outer_vertices);
  check_finite("anchor_share", d.anchor_share, corners);
  check_indices("drawn", d.drawn, d.drawn_count, inner_vertices);
  check_indices("drawn_by", d.drawn_by, from, d.held_count);
  check_finite("drawn_share", d.drawn_share, from);
  held_ = arena.copy(d.held, d.held_count);
  anchor_ = arena.copy(d.anchor, corners);
  anchor_share_ = arena.copy(d.anchor_share, corners);
  drawn_ = arena.copy(d.drawn, d.drawn_count);
  drawn_by_ = arena.copy(d.drawn_by, from);
  drawn_share_ = arena.copy(d.drawn_share, from);
  displacement_ = arena.take<float>(3 * std::size_t(d.held_count));
}

void Tuck::apply(const VertexRows& inner, const VertexRows& outer) noexcept {
  for (int k = 0; k < held_count_; ++k) {
    Vector3 at{0, 0, 0}, normal{0, 0, 0};
    for (int c = kAnchorCorners * k; c < kAnchorCorners * (k + 1); ++c) {
      const ClothPoint corner = load_point(outer, anchor_[c]);
      at = at + anchor_share_[c] * corner.position;
      normal = normal + anchor_share_[c] * corner.normal;
    }
    at = at - kInset * normalized(normal);
    const Vector3 moved = at - load_point(inner, held_[k]).position;
    std::memcpy(displacement_ + 3 * k, &moved, sizeof moved);
    store_position(inner, held_[k], at);
  }
  for (int k = 0; k < drawn_count_; ++k) {
    Vector3 at = load_point(inner, drawn_[k]).position;
    for (int c = kDrawnFrom * k; c < kDrawnFrom * (k + 1); ++c) {
      at = at + drawn_share_[c] * load_vector(displacement_ + 3 * drawn_by_[c]);
    }
    store_position(inner, drawn_[k], at);
  }
}

}  // namespace physkin

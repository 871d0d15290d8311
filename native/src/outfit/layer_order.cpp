#include "outfit/layer_order.hpp"

#include <algorithm>

#include "garment/finite.hpp"
#include "outfit/checks.hpp"
#include "outfit/cloth_point.hpp"

namespace physkin {
namespace {

// Metres and mean edge lengths, as the constants of the same names in layer_order.py.
constexpr float kLayerGap = 0.002f, kSoft = 0.001f, kMostPush = 0.03f, kDeepest = 0.05f, kFade = 0.01f, kFree = 0.012f;
constexpr float kStray = 0.6f, kPlaneReach = 1.3f, kFullShare = 0.5f;
constexpr int kSteps = 4;

struct OffPlane {
  float off, aside_square;
};

inline OffPlane off_plane(Vector3 at, const ClothPoint& plane) {
  const Vector3 gap = at - plane.position;
  const float off = dot(gap, plane.normal);
  return {off, dot(gap, gap) - off * off};
}

inline float clamp01(float v) { return std::min(std::max(v, 0.0f), 1.0f); }

}  // namespace

LayerOrderData read_layer_order(FieldSource& source) {
  LayerOrderData d;
  const auto integers = [&](const char* name, int& size) {
    std::vector<int> shape{size};
    const std::int32_t* values = source.integers(name, shape);
    size = shape[0];
    return values;
  };
  d.contact = integers("contact", d.contacts);
  d.partner = integers("partner", d.contacts);
  d.ring_start = integers("ring_start", d.inner_starts);
  d.ring = integers("ring", d.ring_size);
  d.push_start = integers("push_start", d.contact_starts);
  d.push_to = integers("push_to", d.pushes);
  std::vector<int> shape{d.pushes};
  d.push_share = source.floats("push_share", shape);
  d.moved = integers("moved", d.moved_count);
  return d;
}

LayerOrder::LayerOrder(const LayerOrderData& d, int inner_vertices, int outer_vertices, Arena& arena)
    : contacts_(d.contacts), moved_count_(d.moved_count), edge_(d.edge) {
  check_indices("contact", d.contact, d.contacts, outer_vertices);
  check_indices("partner", d.partner, d.contacts, inner_vertices);
  check_starts("ring_start", d.ring_start, d.inner_starts, inner_vertices, d.ring_size);
  check_indices("ring", d.ring, d.ring_size, inner_vertices);
  check_starts("push_start", d.push_start, d.contact_starts, d.contacts, d.pushes);
  check_indices("push_to", d.push_to, d.pushes, d.moved_count);
  check_finite("push_share", d.push_share, d.pushes, 1.0f);
  check_indices("moved", d.moved, d.moved_count, outer_vertices);
  check_finite("edge", &d.edge, 1);
  contact_ = arena.copy(d.contact, d.contacts);
  partner_ = arena.copy(d.partner, d.contacts);
  ring_start_ = arena.copy(d.ring_start, d.inner_starts);
  ring_ = arena.copy(d.ring, d.ring_size);
  push_start_ = arena.copy(d.push_start, d.contact_starts);
  push_to_ = arena.copy(d.push_to, d.pushes);
  push_share_ = arena.copy(d.push_share, d.pushes);
  moved_ = arena.copy(d.moved, d.moved_count);
  push_ = arena.take<float>(d.moved_count);
}

void LayerOrder::apply(const VertexRows& inner, const VertexRows& outer) noexcept {
  bool any = false;
  for (int c = 0; c < contacts_; ++c) {
    const float wanted = lack(c, inner, outer);
    if (!(wanted > 0.0f)) continue;
    if (!any) std::fill_n(push_, moved_count_, 0.0f);
    any = true;
    for (std::int32_t at = push_start_[c]; at < push_start_[c + 1]; ++at) {
      float& push = push_[push_to_[at]];
      push = std::max(push, wanted * push_share_[at]);
    }
  }
  if (!any) return;
  for (int k = 0; k < moved_count_; ++k) {
    if (push_[k] == 0.0f) continue;
    const ClothPoint point = load_point(outer, moved_[k]);
    store_position(outer, moved_[k], point.position + push_[k] * point.normal);
  }
}

float LayerOrder::lack(int c, const VertexRows& inner, const VertexRows& outer) noexcept {
  const ClothPoint own = load_point(outer, contact_[c]);
  std::int32_t partner = partner_[c];
  OffPlane from = off_plane(own.position, load_point(inner, partner));
  const float stray = (kStray * edge_) * (kStray * edge_);
  for (int step = 0; step < kSteps && from.aside_square > stray; ++step) {
    std::int32_t closest = partner;
    Vector3 gap = own.position - load_point(inner, partner).position;
    float least = dot(gap, gap);
    for (std::int32_t at = ring_start_[partner]; at < ring_start_[partner + 1]; ++at) {
      gap = own.position - load_point(inner, ring_[at]).position;
      const float square = dot(gap, gap);
      if (square < least) least = square, closest = ring_[at];
    }
    if (closest == partner) break;
    partner = closest;
    from = off_plane(own.position, load_point(inner, partner));
  }
  partner_[c] = partner;
  if (from.off > kFree) return 0.0f;

  const float reach = 1.0f / ((kPlaneReach * edge_) * (kPlaneReach * edge_));
  float total = 0.0f, gap = 0.0f, alike = 0.0f;
  const auto add = [&](std::int32_t vertex) {
    const ClothPoint plane = load_point(inner, vertex);
    const OffPlane at = off_plane(own.position, plane);
    const float near = std::max(1.0f - at.aside_square * reach, 0.0f), share = near * near;
    total += share;
    gap += share * at.off;
    alike += share * dot(own.normal, plane.normal);
  };
  add(partner);
  for (std::int32_t at = ring_start_[partner]; at < ring_start_[partner + 1]; ++at) add(ring_[at]);
  const float safe = std::max(total, 1e-6f);
  gap /= safe;
  alike /= safe;
  const float wanted = kLayerGap + kSoft - gap;
  if (!(wanted > 0.0f)) return 0.0f;
  float lack = wanted < 2.0f * kSoft ? wanted * wanted / (4.0f * kSoft) : wanted - kSoft;
  lack *= std::min(total / kFullShare, 1.0f) * clamp01((kDeepest + gap) / kFade);
  lack *= clamp01(2.0f * alike) / std::max(alike, 0.5f);
  return std::min(lack, kMostPush);
}

}  // namespace physkin

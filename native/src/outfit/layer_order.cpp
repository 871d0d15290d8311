#include "outfit/layer_order.hpp"

#include <algorithm>
#include <cfloat>
#include <cstring>
#include <stdexcept>
#include <string>

#include "garment/finite.hpp"
#include "outfit/checks.hpp"
#include "outfit/cloth_point.hpp"

namespace physkin {
namespace {

// Metres and mean edge lengths, as the constants of the same names in layer_order.py.
constexpr float kOrderGap = 0.003f, kSoft = 0.001f, kMostPush = 0.05f, kDeepest = 0.07f, kFade = 0.01f, kFree = 0.01f, kNear = 0.005f, kAgain = 0.001f;
constexpr float kStray = 0.6f, kPlaneReach = 1.3f, kFarAside = 2.0f, kFullShare = 0.5f;
constexpr int kSteps = 4, kPasses = 2, kTurns = 8;

typedef float Quad __attribute__((vector_size(16)));
typedef std::int32_t Places __attribute__((vector_size(16)));

inline Quad load_quad(const unsigned char* at) {
  Quad v;
  std::memcpy(&v, at, sizeof v);
  return v;
}

inline Quad three_of(Quad v) { return (Quad)((Places)v & Places{-1, -1, -1, 0}); }
inline float sum(Quad v) { return v[0] + v[1] + v[2]; }

// Cloth as registers hold it: four floats from the start of a row, and from its third on, stay within the row.
struct Rows {
  explicit Rows(const VertexRows& rows)
      : data(rows.data), stride(rows.stride * std::ptrdiff_t(sizeof(float))) {}

  Quad position(std::int32_t vertex) const { return load_quad(data + vertex * stride); }  // x y z and another number
  Quad normal(std::int32_t vertex) const {                                                // nx ny nz and another one
    const Quad v = load_quad(data + vertex * stride + 2 * sizeof(float));
    return Quad{v[1], v[2], v[3], v[0]};
  }

  const unsigned char* data;
  std::ptrdiff_t stride;
};

struct OffPlane {
  float off, aside_square;
};

inline OffPlane off_plane(Quad at, const Rows& planes, std::int32_t vertex) {
  const Quad gap = three_of(at - planes.position(vertex));
  const float off = sum(gap * planes.normal(vertex));
  return {off, sum(gap * gap) - off * off};
}

// How a contact is looked at in a pass: not at all, at its partner, or with a search for a closer one.
enum class Look { away, here, search };

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
  d.seed_start = integers("seed_start", d.seed_starts);
  d.seed = integers("seed", d.seeds);
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
  check_starts("seed_start", d.seed_start, d.seed_starts, d.contacts, d.seeds);
  check_indices("seed", d.seed, d.seeds, inner_vertices);
  check_starts("ring_start", d.ring_start, d.inner_starts, inner_vertices, d.ring_size);
  check_indices("ring", d.ring, d.ring_size, inner_vertices);
  check_starts("push_start", d.push_start, d.contact_starts, d.contacts, d.pushes);
  check_indices("push_to", d.push_to, d.pushes, d.moved_count);
  check_finite("push_share", d.push_share, d.pushes, 1.0f);
  check_indices("moved", d.moved, d.moved_count, outer_vertices);
  check_finite("edge", &d.edge, 1);
  contact_ = arena.copy(d.contact, d.contacts);
  auto* place = arena.take<std::int32_t>(d.contacts);
  std::vector<std::int32_t> place_of(std::size_t(outer_vertices), -1);
  for (int k = 0; k < d.moved_count; ++k) place_of[d.moved[k]] = k;
  for (int c = 0; c < d.contacts; ++c) {
    place[c] = place_of[d.contact[c]];
    if (place[c] < 0) throw std::invalid_argument("contact[" + std::to_string(c) + "] is not among those moved");
  }
  contact_place_ = place;
  push_start_ = arena.copy(d.push_start, d.contact_starts);
  push_to_ = arena.copy(d.push_to, d.pushes);
  push_share_ = arena.copy(d.push_share, d.pushes);
  moved_ = arena.copy(d.moved, d.moved_count);
  push_ = arena.take<float>(d.moved_count);
  has_moved_ = arena.take<bool>(d.moved_count);

  seed_start_ = arena.copy(d.seed_start, d.seed_starts);
  seed_ = arena.copy(d.seed, d.seeds);
  ring_start_ = arena.copy(d.ring_start, d.inner_starts);
  ring_ = arena.copy(d.ring, d.ring_size);
  partner_ = arena.take<std::int32_t>(d.contacts);
  free_ = arena.take<bool>(d.contacts);
  for (int c = 0; c < d.contacts; ++c) {
    if (d.seed_start[c] == d.seed_start[c + 1]) {
      throw std::invalid_argument("seed_start[" + std::to_string(c) + "]: a contact needs a seed");
    }
    partner_[c] = d.seed[d.seed_start[c]];
  }
}

void LayerOrder::apply(const VertexRows& inner, const VertexRows& outer, bool look_at_all) noexcept {
  const int turn = frame_++ % kTurns;
  bool any = push_lacking(inner, outer, [&](int c) {
    const bool search = look_at_all || c % kTurns == turn;
    return search ? Look::search : free_[c] ? Look::away : Look::here;
  });
  for (int pass = 1; any && pass < kPasses; ++pass) {
    any = push_lacking(inner, outer, [&](int c) {
      return has_moved_[contact_place_[c]] ? Look::here : Look::away;
    });
  }
}

template <class Looks>
bool LayerOrder::push_lacking(const VertexRows& inner, const VertexRows& outer, Looks looks_at) noexcept {
  bool any = false;
  for (int c = 0; c < contacts_; ++c) {
    const Look look = looks_at(c);
    if (look == Look::away) continue;
    const float wanted = lack(c, inner, outer, look == Look::search);
    if (!(wanted > 0.0f)) continue;
    if (!any) std::fill_n(push_, moved_count_, 0.0f);
    any = true;
    for (std::int32_t at = push_start_[c]; at < push_start_[c + 1]; ++at) {
      float& push = push_[push_to_[at]];
      push = std::max(push, wanted * push_share_[at]);
    }
  }
  if (!any) return false;
  for (int k = 0; k < moved_count_; ++k) {
    has_moved_[k] = push_[k] > kAgain;
    if (push_[k] == 0.0f) continue;
    const ClothPoint point = load_point(outer, moved_[k]);
    store_position(outer, moved_[k], point.position + push_[k] * point.normal);
  }
  return true;
}

float LayerOrder::lack(int c, const VertexRows& inner_rows, const VertexRows& outer_rows, bool search) noexcept {
  const Rows inner(inner_rows), outer(outer_rows);
  const Quad at = outer.position(contact_[c]);
  std::int32_t partner = partner_[c];
  float least = FLT_MAX;
  const auto choose_among = [&](const std::int32_t* vertex, const std::int32_t* end) {
    for (; vertex != end; ++vertex) {
      const Quad gap = three_of(at - inner.position(*vertex));
      const float square = sum(gap * gap);
      partner = square < least ? *vertex : partner;
      least = std::min(square, least);
    }
  };
  OffPlane from = off_plane(at, inner, partner);
  if (search || from.aside_square > edge_ * edge_) {
    choose_among(partner_ + c, partner_ + c + 1);
    choose_among(seed_ + seed_start_[c], seed_ + seed_start_[c + 1]);
    const float stray = (kStray * edge_) * (kStray * edge_);
    from = off_plane(at, inner, partner);
    for (int step = 0; step < kSteps && from.aside_square > stray; ++step) {
      const std::int32_t before = partner;
      choose_among(ring_ + ring_start_[partner], ring_ + ring_start_[partner + 1]);
      if (partner == before) break;
      from = off_plane(at, inner, partner);
    }
  }
  partner_[c] = partner;
  free_[c] = from.off > kFree || from.aside_square > (kFarAside * edge_) * (kFarAside * edge_);
  if (free_[c] || from.off > kNear) return 0.0f;

  const float reach = 1.0f / ((kPlaneReach * edge_) * (kPlaneReach * edge_));
  const Quad own = outer.normal(contact_[c]);
  float total = 0.0f, gap = 0.0f;
  Quad normals = {};
  const auto add = [&](std::int32_t vertex) {
    const OffPlane plane = off_plane(at, inner, vertex);
    const float near = std::max(1.0f - plane.aside_square * reach, 0.0f), share = near * near;
    total += share;
    gap += share * plane.off;
    normals += share * inner.normal(vertex);
  };
  add(partner);
  for (std::int32_t k = ring_start_[partner]; k < ring_start_[partner + 1]; ++k) add(ring_[k]);
  const float safe = std::max(total, 1e-6f);
  gap /= safe;
  const float alike = sum(own * normals) / safe;
  const float wanted = kOrderGap + kSoft - gap;
  if (!(wanted > 0.0f)) return 0.0f;
  float lack = wanted < 2.0f * kSoft ? wanted * wanted / (4.0f * kSoft) : wanted - kSoft;
  lack *= std::min(total / kFullShare, 1.0f) * clamp01((kDeepest + gap) / kFade);
  lack *= clamp01(4.0f * alike) / std::max(alike, 0.5f);
  return std::min(lack, kMostPush);
}

}  // namespace physkin

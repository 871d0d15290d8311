#include "evaluator/face_normals.hpp"

#include <algorithm>
#include <cstring>
#include <numeric>
#include <stdexcept>
#include <utility>
#include <vector>

#include "evaluator/curve_positions.hpp"
#include "kernels/shared.hpp"

namespace physkin {
namespace {

using Ring = std::vector<std::int32_t>;

struct Side {  // of a face, opposite the vertex
  std::int32_t from, to;
};

// The ring of a vertex from the sides opposite it: neighbours in order, all around; or, where there is more than one way
// round or a gap, of each fan of faces the vertex itself and then the fan's neighbours.
Ring ring_of(std::int32_t vertex, std::vector<Side> sides) {
  const auto starts_from = [&](std::int32_t from) {
    return std::find_if(sides.begin(), sides.end(), [&](const Side& side) { return side.from == from; });
  };
  const auto ends_at = [&](std::int32_t to) {
    return std::any_of(sides.begin(), sides.end(), [&](const Side& side) { return side.to == to; });
  };
  Ring ring;
  while (!sides.empty()) {
    auto next = std::find_if(sides.begin(), sides.end(), [&](const Side& side) { return !ends_at(side.from); });
    if (next == sides.end()) next = sides.begin();  // what is left goes all around
    Ring fan{next->from};
    while (next != sides.end()) {
      fan.push_back(next->to);
      sides.erase(next);
      next = starts_from(fan.back());
    }
    if (ring.empty() && sides.empty() && fan.front() == fan.back()) {
      fan.pop_back();
      return fan;
    }
    ring.push_back(vertex);
    ring.insert(ring.end(), fan.begin(), fan.end());
  }
  return ring.empty() ? Ring{vertex} : ring;
}

std::vector<Ring> rings_of(const SkinningData& g) {
  std::vector<std::vector<Side>> sides(g.vertex_count);
  for (const std::int32_t* corner = g.faces; corner != g.faces + 3 * std::ptrdiff_t(g.face_count); corner += 3) {
    for (int k = 0; k < 3; ++k) sides[corner[k]].push_back({corner[(k + 1) % 3], corner[(k + 2) % 3]});
  }
  std::vector<Ring> rings;
  for (int v = 0; v < g.vertex_count; ++v) rings.push_back(ring_of(v, std::move(sides[v])));
  return rings;
}

template <class Index, class Given>
const Index* copy_as(const std::vector<Given>& given, Arena& arena) {
  auto* target = arena.take<Index>(given.size());
  std::transform(given.begin(), given.end(), target, [](Given index) { return Index(index); });
  return target;
}

// Neighbours that a ring takes in its group.
std::size_t steps(const Ring& ring) { return (ring.size() + 1) / 2 * 2; }

// Rings of a mesh, whatever body wears it: without places.
struct PackedRings {
  FaceRings rings;
  const std::int32_t* place_of;
};

PackedRings pack_rings(const SkinningData& g, Arena& arena) {
  const std::vector<Ring> rings = rings_of(g);
  // By their length, so that the processor foresees where loops end; then neighbours together, for its caches.
  const std::vector<std::uint32_t> curve = curve_positions(g);
  std::vector<std::int32_t> order(g.vertex_count), place_of(g.vertex_count), start{0};
  std::vector<std::uint32_t> neighbours;
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return std::make_pair(steps(rings[a]), curve[a]) < std::make_pair(steps(rings[b]), curve[b]);
  });
  const std::size_t missing = (kRingGroup - order.size() % kRingGroup) % kRingGroup;
  order.insert(order.begin(), missing, order.front());
  for (std::size_t k = 0; k < order.size(); ++k) place_of[order[k]] = std::int32_t(k);
  for (std::size_t first = 0; first < order.size(); first += kRingGroup) {
    for (std::size_t step = 0; step < steps(rings[order[first + kRingGroup - 1]]); ++step) {
      for (int k = 0; k < kRingGroup; ++k) {
        const Ring& ring = rings[order[first + k]];
        neighbours.push_back(2 * std::uint32_t(place_of[ring[std::min(step, ring.size() - 1)]]));
      }
    }
    start.push_back(std::int32_t(neighbours.size() / kRingGroup));
  }
  PackedRings packed;
  packed.place_of = arena.copy(place_of.data(), place_of.size());
  arena.leave_out(place_of.size() * sizeof(std::int32_t));  // only a frame in which others move vertices reads it
  packed.rings.group_count = int(order.size() / kRingGroup);
  packed.rings.start = arena.copy(start.data(), start.size());
  if (2 * (order.size() - 1) <= UINT16_MAX) {
    packed.rings.narrow = {copy_as<std::uint16_t>(order, arena), copy_as<std::uint16_t>(neighbours, arena)};
  } else {
    packed.rings.wide = {copy_as<std::uint32_t>(order, arena), copy_as<std::uint32_t>(neighbours, arena)};
  }
  return packed;
}

}  // namespace

FaceNormals::FaceNormals(const SkinningData& g, const Kernels& kernels, Arena& arena)
    : kernels_(kernels), vertex_count_(g.vertex_count) {
  if (g.face_count == 0) throw std::invalid_argument("normals of faces need a garment with faces; this one has none");
  Digest digest;
  digest.add(g.vertex_count).add(g.faces, 3 * std::size_t(g.face_count));
  const auto packed = shared_in<PackedRings>(arena, digest, [&](Arena& own) { return pack_rings(g, own); });
  place_of_ = packed.place_of;
  rings_ = packed.rings;
  rings_.places = arena.take<float>(4 * std::size_t(rings_.group_count) * kRingGroup);
}

void FaceNormals::place(const VertexRows& rows) noexcept {
  const std::ptrdiff_t row_bytes = rows.stride * std::ptrdiff_t(sizeof(float));
  for (int v = 0; v < vertex_count_; ++v) {
    std::memcpy(rings_.places + 4 * place_of_[v], rows.data + v * row_bytes, 3 * sizeof(float));
  }
}

}  // namespace physkin

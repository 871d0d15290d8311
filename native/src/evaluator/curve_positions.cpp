#include "evaluator/curve_positions.hpp"

#include <algorithm>
#include <limits>

namespace physkin {
namespace {

// Vertices that each vertex has an edge to: those of `v` from starts[v] on.
struct Neighbours {
  explicit Neighbours(const SkinningData& g) : starts(std::size_t(g.vertex_count) + 1), of(6 * std::size_t(g.face_count)) {
    const std::size_t corners = 3 * std::size_t(g.face_count);
    for (std::size_t at = 0; at < corners; ++at) starts[std::size_t(g.faces[at]) + 1] += 2;
    for (std::size_t v = 1; v < starts.size(); ++v) starts[v] += starts[v - 1];
    std::vector<std::int32_t> next(starts.begin(), starts.end() - 1);
    for (std::size_t at = 0; at < corners; ++at) {
      for (std::size_t k = 1; k < 3; ++k) {
        of[std::size_t(next[std::size_t(g.faces[at])]++)] = g.faces[at / 3 * 3 + (at + k) % 3];
      }
    }
  }
  std::vector<std::int32_t> starts, of;
};

// Steps from a vertex to each; to those that no edges lead to, one more than to the farthest.
std::vector<int> steps_from(int vertex, const Neighbours& neighbours) {
  std::vector<int> steps(neighbours.starts.size() - 1, -1), queue{vertex};
  steps[std::size_t(vertex)] = 0;
  for (std::size_t k = 0; k < queue.size(); ++k) {
    const auto from = std::size_t(queue[k]);
    for (auto at = neighbours.starts[from]; at < neighbours.starts[from + 1]; ++at) {
      const std::int32_t to = neighbours.of[std::size_t(at)];
      if (steps[std::size_t(to)] >= 0) continue;
      steps[std::size_t(to)] = steps[from] + 1;
      queue.push_back(to);
    }
  }
  std::replace(steps.begin(), steps.end(), -1, steps[std::size_t(queue.back())] + 1);
  return steps;
}

}  // namespace

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

std::vector<std::uint32_t> curve_positions(const SkinningData& g) {
  if (g.face_count <= 0) return curve_positions(g.vertices, g.vertex_count);
  const Neighbours neighbours(g);
  std::vector<float> places(3 * std::size_t(g.vertex_count));
  std::vector<int> nearest(std::size_t(g.vertex_count), std::numeric_limits<int>::max());
  int start = 0;
  for (int c = -1; c < 3; ++c) {  // the first only leads to a vertex at an end
    const std::vector<int> steps = steps_from(start, neighbours);
    for (std::size_t v = 0; v < steps.size(); ++v) {
      if (c >= 0) places[3 * v + std::size_t(c)] = float(steps[v]);
      nearest[v] = c > 0 ? std::min(nearest[v], steps[v]) : steps[v];
    }
    start = int(std::max_element(nearest.begin(), nearest.end()) - nearest.begin());
  }
  return curve_positions(places.data(), g.vertex_count);
}

}  // namespace physkin

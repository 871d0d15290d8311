#include "evaluator/curve_positions.hpp"

#include <algorithm>
#include <limits>

namespace physkin {
namespace {

// A vertex joins nodes whose skinning weights there are more than this.
constexpr float kJoins = 0.2f;

// Steps from a garment node to each, from node to node that have a vertex in common; to those that none leads to, one
// more than to the farthest.
std::vector<int> steps_from(int node, const SkinningData& g, const std::vector<std::vector<std::int32_t>>& vertices) {
  std::vector<int> steps(vertices.size(), -1), queue{node};
  std::vector<bool> seen(std::size_t(g.vertex_count));
  steps[std::size_t(node)] = 0;
  for (std::size_t k = 0; k < queue.size(); ++k) {
    for (const std::int32_t vertex : vertices[std::size_t(queue[k])]) {
      if (seen[std::size_t(vertex)]) continue;
      seen[std::size_t(vertex)] = true;
      for (int at = vertex * g.influences; at < (vertex + 1) * g.influences; ++at) {
        const std::int32_t to = g.influence_nodes[at];
        if (!(g.influence_weights[at] > kJoins) || steps[std::size_t(to)] >= 0) continue;
        steps[std::size_t(to)] = steps[std::size_t(queue[k])] + 1;
        queue.push_back(to);
      }
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
  std::vector<std::vector<std::int32_t>> vertices(std::size_t(g.nodes));
  const int influences = g.vertex_count * g.influences;
  for (int at = 0; at < influences; ++at) {
    if (g.influence_weights[at] > kJoins) vertices[std::size_t(g.influence_nodes[at])].push_back(at / g.influences);
  }
  std::vector<float> places(3 * std::size_t(g.vertex_count));
  std::vector<int> nearest(vertices.size(), std::numeric_limits<int>::max());
  int start = 0;
  for (int c = -1; c < 3; ++c) {  // the first only leads to a node at an end
    const std::vector<int> steps = steps_from(start, g, vertices);
    for (int at = 0; c >= 0 && at < influences; ++at) {
      places[std::size_t(3 * (at / g.influences) + c)] +=
          g.influence_weights[at] * float(steps[std::size_t(g.influence_nodes[at])]);
    }
    for (std::size_t k = 0; k < steps.size(); ++k) nearest[k] = c > 0 ? std::min(nearest[k], steps[k]) : steps[k];
    start = int(std::max_element(nearest.begin(), nearest.end()) - nearest.begin());
  }
  return curve_positions(places.data(), g.vertex_count);
}

}  // namespace physkin

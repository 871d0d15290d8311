#include "skinning_blocks.hpp"

#include <algorithm>
#include <numeric>
#include <set>
#include <vector>

namespace physkin {
namespace {

// Garment nodes with a weight on each vertex, in order of index: vertices next to each other in the order of these
// lists share most of their garment nodes (a fifth fewer in a block's union than ordered by weight).
std::vector<std::vector<std::int32_t>> influence_sets(const BoundGarment& g) {
  std::vector<std::vector<std::int32_t>> sets(g.vertex_count);
  for (std::size_t at = 0; at < std::size_t(g.vertex_count) * g.influences; ++at) {
    if (g.influence_weights[at] != 0.0f) sets[at / g.influences].push_back(g.influence_nodes[at]);
  }
  for (auto& nodes : sets) std::sort(nodes.begin(), nodes.end());
  return sets;
}

}  // namespace

SkinningBlocks pack_skinning_blocks(const BoundGarment& g, Arena& arena) {
  const auto sets = influence_sets(g);
  std::vector<std::int32_t> order(g.vertex_count);
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return sets[a] < sets[b]; });

  SkinningBlocks blocks;
  blocks.vertex_count = g.vertex_count;
  blocks.block_count = (g.vertex_count + kBlock - 1) / kBlock;

  // The union of each block's garment nodes.
  std::vector<std::int32_t> nodes, start{0};
  for (int first = 0; first < g.vertex_count; first += kBlock) {
    std::set<std::int32_t> in_block;
    for (int i = first; i < std::min(first + kBlock, g.vertex_count); ++i) {
      in_block.insert(sets[order[i]].begin(), sets[order[i]].end());
    }
    nodes.insert(nodes.end(), in_block.begin(), in_block.end());
    start.push_back(std::int32_t(nodes.size()));
  }

  auto* weights = arena.take<float>(nodes.size() * kBlock);
  auto* rest = arena.take<float>(std::size_t(blocks.block_count) * 6 * kBlock);
  auto* vertex = arena.take<std::int32_t>(std::size_t(blocks.block_count) * kBlock);
  for (int i = 0; i < g.vertex_count; ++i) {
    const int block = i / kBlock, lane = i % kBlock;
    const std::size_t v = order[i];
    vertex[i] = order[i];
    for (int c = 0; c < 3; ++c) {
      rest[(std::size_t(block) * 6 + c) * kBlock + lane] = g.vertices[3 * v + c];
      rest[(std::size_t(block) * 6 + 3 + c) * kBlock + lane] = g.normals[3 * v + c];
    }
    for (int k = 0; k < g.influences; ++k) {
      const float weight = g.influence_weights[v * g.influences + k];
      if (weight == 0.0f) continue;
      const auto begin = nodes.begin() + start[block], end = nodes.begin() + start[block + 1];
      const auto at = std::lower_bound(begin, end, g.influence_nodes[v * g.influences + k]) - nodes.begin();
      weights[std::size_t(at) * kBlock + lane] += weight;  // a node may be listed twice
    }
  }
  blocks.influence_start = arena.copy(start.data(), start.size());
  blocks.influence_node = arena.copy(nodes.data(), nodes.size());
  blocks.influence_weight = weights;
  blocks.rest = rest;
  blocks.vertex = vertex;
  return blocks;
}

}  // namespace physkin

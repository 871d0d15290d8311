#include "skinning_blocks.hpp"

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <vector>

namespace physkin {
namespace {

using NodeSet = std::vector<std::int32_t>;  // garment nodes in order of index

// Garment nodes with a weight on each vertex.
std::vector<NodeSet> influence_sets(const BoundGarment& g) {
  std::vector<NodeSet> sets(g.vertex_count);
  for (std::size_t at = 0; at < std::size_t(g.vertex_count) * g.influences; ++at) {
    if (g.influence_weights[at] != 0.0f) sets[at / g.influences].push_back(g.influence_nodes[at]);
  }
  for (NodeSet& nodes : sets) {
    std::sort(nodes.begin(), nodes.end());
    nodes.erase(std::unique(nodes.begin(), nodes.end()), nodes.end());
  }
  return sets;
}

struct Block {
  std::vector<std::int32_t> vertices;
  NodeSet nodes;  // union of the vertices' sets
};

// Vertices that a block is chosen from: the work of packing grows with it, the unions hardly shrink beyond.
constexpr std::size_t kWindow = 256;

// Blocks with small unions: vertices sorted by their sets, a block taking from the first of those left whichever adds
// the fewest garment nodes. A fifth smaller unions than blocks of neighbours in sorted order.
std::vector<Block> choose_blocks(const std::vector<NodeSet>& sets, int node_count) {
  std::vector<std::int32_t> order(sets.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return sets[a] < sets[b]; });

  std::vector<Block> blocks;
  std::vector<std::int32_t> window;
  std::vector<bool> in_block(node_count);
  auto next = order.begin();
  while (next != order.end() || !window.empty()) {
    const auto count = std::min(kWindow - window.size(), std::size_t(order.end() - next));
    window.insert(window.end(), next, next + std::ptrdiff_t(count));
    next += std::ptrdiff_t(count);
    Block block;
    while (block.vertices.size() < std::size_t(kBlock) && !window.empty()) {
      const auto added = [&](int v) {
        return std::count_if(sets[v].begin(), sets[v].end(), [&](int node) { return !in_block[node]; });
      };
      std::size_t best = 0;
      auto fewest = added(window[0]);
      for (std::size_t k = 1; k < window.size() && fewest > 0 && !block.vertices.empty(); ++k) {
        if (const auto more = added(window[k]); more < fewest) fewest = more, best = k;
      }
      const std::int32_t vertex = window[best];
      window.erase(window.begin() + std::ptrdiff_t(best));
      block.vertices.push_back(vertex);
      for (const std::int32_t node : sets[vertex]) {
        if (!in_block[node]) block.nodes.push_back(node);
        in_block[node] = true;
      }
    }
    for (const std::int32_t node : block.nodes) in_block[node] = false;
    if (block.nodes.empty()) block.nodes.push_back(0);  // vertices without any weight: the kernel reads one node
    std::sort(block.nodes.begin(), block.nodes.end());
    blocks.push_back(std::move(block));
  }
  if (blocks.empty()) return blocks;
  // Blocks of equal size follow each other, so that the processor foresees where the loop over garment nodes ends. The
  // last one, which may be short of vertices, stays last.
  std::stable_sort(blocks.begin(), blocks.end() - 1,
                   [](const Block& a, const Block& b) { return a.nodes.size() < b.nodes.size(); });
  return blocks;
}

}  // namespace

SkinningBlocks pack_skinning_blocks(const BoundGarment& g, Arena& arena) {
  const std::vector<Block> chosen = choose_blocks(influence_sets(g), g.nodes);
  SkinningBlocks blocks;
  blocks.vertex_count = g.vertex_count;
  blocks.block_count = int(chosen.size());

  std::vector<std::int32_t> order, nodes, start{0};
  for (const Block& block : chosen) {
    order.insert(order.end(), block.vertices.begin(), block.vertices.end());
    nodes.insert(nodes.end(), block.nodes.begin(), block.nodes.end());
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
  for (std::int32_t& node : nodes) node *= 12;
  blocks.influence_matrix = arena.copy(nodes.data(), nodes.size());
  blocks.influence_weight = weights;
  blocks.rest = rest;
  blocks.vertex = vertex;
  return blocks;
}

}  // namespace physkin

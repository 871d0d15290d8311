// Which vertices the skinning kernel works on together.
#include <algorithm>
#include <array>
#include <cstdint>
#include <map>
#include <numeric>
#include <vector>

#include "evaluator/skinner.hpp"

namespace physkin {
namespace {

using NodeSet = std::vector<std::int32_t>;  // garment nodes in order of index

// Garment nodes with a weight on each vertex.
std::vector<NodeSet> influence_sets(const SkinningData& g) {
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

// Positions along a curve that keeps neighbours together (Morton): the bits of the three coordinates in turn.
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

// Vertices that a block is chosen from: the work of packing grows with it, the unions hardly shrink beyond.
constexpr std::size_t kWindow = 1024;

// Vertices in order of `curve`, a block taking from the first of those left whichever adds the fewest garment nodes.
class BlockChooser {
 public:
  BlockChooser(const std::vector<NodeSet>& sets, const std::vector<std::uint32_t>& curve, int node_count)
      : sets_(sets), order_(sets.size()), words_((std::size_t(node_count) + 63) / 64), in_block_(node_count) {
    std::iota(order_.begin(), order_.end(), 0);
    std::stable_sort(order_.begin(), order_.end(), [&](int a, int b) { return curve[a] < curve[b]; });
    masks_.resize(sets.size() * words_);
    for (std::size_t v = 0; v < sets.size(); ++v) {
      for (const std::int32_t node : sets[v]) masks_[v * words_ + node / 64] |= std::uint64_t{1} << node % 64;
    }
  }

  bool done() const { return next_ == order_.size() && window_.empty(); }

  Block choose() {
    for (; window_.size() < kWindow && next_ < order_.size(); ++next_) window_.push_back(order_[next_]);
    added_.clear();
    for (const std::int32_t v : window_) added_.push_back(int(sets_[v].size()));
    Block block;
    take(block, 0);
    while (block.vertices.size() < std::size_t(kBlock) && !window_.empty()) {
      take(block, fewest_added());
    }
    for (const std::int32_t node : block.nodes) in_block_[node] = false;
    if (block.nodes.empty()) block.nodes.push_back(0);  // vertices without any weight: the kernel reads one node
    std::sort(block.nodes.begin(), block.nodes.end());
    return block;
  }

 private:
  std::ptrdiff_t fewest_added() const {
    std::size_t best = 0;
    for (std::size_t k = 1; k < added_.size() && added_[best] > 0; ++k) {
      if (added_[k] < added_[best]) best = k;
    }
    return std::ptrdiff_t(best);
  }

  void take(Block& block, std::ptrdiff_t at) {
    const std::int32_t vertex = window_[at];
    window_.erase(window_.begin() + at);
    added_.erase(added_.begin() + at);
    block.vertices.push_back(vertex);
    for (const std::int32_t node : sets_[vertex]) {
      if (in_block_[node]) continue;
      in_block_[node] = true;
      block.nodes.push_back(node);
      for (std::size_t k = 0; k < window_.size(); ++k) {
        added_[k] -= int(masks_[window_[k] * words_ + node / 64] >> node % 64 & 1);
      }
    }
  }

  const std::vector<NodeSet>& sets_;
  std::vector<std::int32_t> order_;
  std::size_t next_ = 0, words_;
  std::vector<std::uint64_t> masks_;  // (vertices, words_) a bit for each garment node
  std::vector<std::int32_t> window_;  // vertices to choose from
  std::vector<int> added_;            // garment nodes that each of them would add to the block
  std::vector<bool> in_block_;
};

std::vector<Block> choose_blocks(const SkinningData& g) {
  const std::vector<NodeSet> sets = influence_sets(g);
  BlockChooser chooser(sets, curve_positions(g.vertices, g.vertex_count), g.nodes);
  std::vector<Block> blocks;
  while (!chooser.done()) blocks.push_back(chooser.choose());
  if (blocks.empty()) return blocks;
  // Blocks of equal size follow each other, so that the processor foresees where the loop over garment nodes ends. The
  // last one, which may be short of vertices, stays last.
  std::stable_sort(blocks.begin(), blocks.end() - 1,
                   [](const Block& a, const Block& b) { return a.nodes.size() < b.nodes.size(); });
  return blocks;
}

// Detail nodes of each block, and the weights of its vertices. order: vertices, block by block.
void pack_detail(const SkinningData& g, const std::vector<std::int32_t>& order, SkinningBlocks& blocks, Arena& arena) {
  std::vector<std::int32_t> offsets, start{0};
  std::vector<float> weights;
  for (int block = 0; block < blocks.block_count; ++block) {
    std::map<std::int32_t, std::array<float, kBlock>> of_nodes;
    const int first = block * kBlock, count = std::min(kBlock, g.vertex_count - first);
    for (int lane = 0; lane < count; ++lane) {
      const std::size_t at = std::size_t(order[std::size_t(first + lane)]) * std::size_t(g.detail_influences);
      for (int k = 0; k < g.detail_influences; ++k) {
        if (g.detail_weights[at + k] != 0.0f) of_nodes[g.detail_nodes[at + k]][lane] += g.detail_weights[at + k];
      }
    }
    for (const auto& [node, of_lanes] : of_nodes) {
      offsets.push_back(3 * node);
      weights.insert(weights.end(), of_lanes.begin(), of_lanes.end());
    }
    start.push_back(std::int32_t(offsets.size()));
  }
  blocks.detail_start = arena.copy(start.data(), start.size());
  blocks.detail_offset = arena.copy(offsets.data(), offsets.size());
  blocks.detail_weight = arena.copy(weights.data(), weights.size());
}

}  // namespace

SkinningBlocks pack_skinning_blocks(const SkinningData& g, Arena& arena) {
  const std::vector<Block> chosen = choose_blocks(g);
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
  if (g.has_detail()) pack_detail(g, order, blocks, arena);
  return blocks;
}

}  // namespace physkin

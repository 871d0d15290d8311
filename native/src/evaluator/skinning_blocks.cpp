// Which vertices the skinning kernel works on together.
#include <algorithm>
#include <array>
#include <cfloat>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <numeric>
#include <utility>
#include <vector>

#include "evaluator/curve_positions.hpp"
#include "evaluator/skinner.hpp"

namespace physkin {
namespace {

using NodeSet = std::vector<std::int32_t>;  // garment nodes in order of index, then detail nodes, counted on from these

// What a node costs a block, in threes of multiply-adds: a matrix, or an offset.
constexpr int kNodeCost = 4, kDetailCost = 1;

// Nodes with a weight on each vertex.
std::vector<NodeSet> influence_sets(const SkinningData& g) {
  std::vector<NodeSet> sets(g.vertex_count);
  for (std::size_t at = 0; at < std::size_t(g.vertex_count) * g.influences; ++at) {
    if (g.influence_weights[at] != 0.0f) sets[at / g.influences].push_back(g.influence_nodes[at]);
  }
  if (g.has_detail()) {
    for (std::size_t at = 0; at < std::size_t(g.vertex_count) * g.detail_influences; ++at) {
      if (g.detail_weights[at] != 0.0f) sets[at / g.detail_influences].push_back(g.nodes + g.detail_nodes[at]);
    }
  }
  for (NodeSet& nodes : sets) {
    std::sort(nodes.begin(), nodes.end());
    nodes.erase(std::unique(nodes.begin(), nodes.end()), nodes.end());
  }
  return sets;
}

struct Block {
  std::vector<std::int32_t> vertices;
  NodeSet nodes;  // union of the vertices' garment nodes
  int detail_nodes = 0;
};

// Vertices that a block is chosen from: the work of packing grows with it, the unions hardly shrink beyond.
constexpr std::size_t kWindow = 1024;

// Vertices in order of `curve`, a block taking from the first of those left whichever adds the least work. A
// place is an index in that order.
class BlockChooser {
 public:
  BlockChooser(const std::vector<NodeSet>& sets, const std::vector<std::uint32_t>& curve, int nodes, int detail_nodes)
      : sets_(sets),
        nodes_(nodes),
        order_(sets.size()),
        added_(sets.size()),
        places_(std::size_t(nodes) + std::size_t(detail_nodes)),
        in_block_(places_.size()) {
    std::iota(order_.begin(), order_.end(), 0);
    std::stable_sort(order_.begin(), order_.end(), [&](int a, int b) { return curve[a] < curve[b]; });
    for (const std::int32_t vertex : order_) {
      for (const std::int32_t node : sets[vertex]) places_[node].push_back(std::int32_t(sizes_.size()));
      sizes_.push_back(std::accumulate(sets[vertex].begin(), sets[vertex].end(), 0,
                                       [&](int sum, std::int32_t node) { return sum + cost(node); }));
    }
  }

  bool done() const { return first_ == order_.size(); }

  Block choose() {
    for (; waiting_ < kWindow && end_ < order_.size(); ++end_) ++waiting_;
    std::copy(sizes_.begin() + first_, sizes_.begin() + end_, added_.begin() + first_);
    Block block;
    take(block, first_);
    while (block.vertices.size() < std::size_t(kBlock) && waiting_ > 0) take(block, least_added());
    while (first_ < end_ && sizes_[first_] == kTaken) ++first_;
    for (const std::int32_t node : block.nodes) in_block_[node] = false;
    std::sort(block.nodes.begin(), block.nodes.end());
    const auto detail = std::lower_bound(block.nodes.begin(), block.nodes.end(), nodes_);
    block.detail_nodes = int(block.nodes.end() - detail);
    block.nodes.erase(detail, block.nodes.end());
    if (block.nodes.empty()) block.nodes.push_back(0);  // vertices without any weight: the kernel reads one node
    return block;
  }

 private:
  // More than any vertex adds, even less all nodes.
  static constexpr int kTaken = std::numeric_limits<int>::max();

  int cost(std::int32_t node) const { return node < nodes_ ? kNodeCost : kDetailCost; }

  // The first place of those that add the least work.
  std::size_t least_added() const {
    const auto first = added_.begin() + first_, end = added_.begin() + end_;
    int least = kTaken;
    for (auto added = first; added != end; ++added) least = std::min(least, *added);  // in vector registers
    return first_ + std::size_t(std::find(first, end, least) - first);
  }

  void take(Block& block, std::size_t place) {
    --waiting_;
    sizes_[place] = added_[place] = kTaken;
    const std::int32_t vertex = order_[place];
    block.vertices.push_back(vertex);
    for (const std::int32_t node : sets_[vertex]) {
      if (in_block_[node]) continue;
      in_block_[node] = true;
      block.nodes.push_back(node);
      const std::vector<std::int32_t>& places = places_[node];
      auto at = std::lower_bound(places.begin(), places.end(), std::int32_t(first_));
      for (; at != places.end() && *at < std::int32_t(end_); ++at) added_[*at] -= cost(node);
    }
  }

  const std::vector<NodeSet>& sets_;
  std::int32_t nodes_;
  std::vector<std::int32_t> order_;                // (vertices) by place
  std::vector<int> sizes_, added_;                 // (vertices) what a place costs, and adds to the block
  std::vector<std::vector<std::int32_t>> places_;  // of each node, in order
  std::vector<bool> in_block_;                     // (nodes)
  std::size_t first_ = 0, end_ = 0;                // places that the block is chosen from
  std::size_t waiting_ = 0;                        // those of them that are not taken
};

std::vector<Block> choose_blocks(const SkinningData& g) {
  const std::vector<NodeSet> sets = influence_sets(g);
  BlockChooser chooser(sets, curve_positions(g.vertices, g.vertex_count), g.nodes,
                       g.has_detail() ? g.detail_numbers / 3 : 0);
  std::vector<Block> blocks;
  while (!chooser.done()) blocks.push_back(chooser.choose());
  if (blocks.empty()) return blocks;
  // Blocks of equal size follow each other, so that the processor foresees where loops over nodes end. The last one,
  // which may be short of vertices, stays last.
  std::stable_sort(blocks.begin(), blocks.end() - 1, [](const Block& a, const Block& b) {
    return std::make_pair(a.nodes.size(), a.detail_nodes) < std::make_pair(b.nodes.size(), b.detail_nodes);
  });
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
  const float largest = std::accumulate(weights.begin(), weights.end(), FLT_MIN,
                                        [](float so_far, float weight) { return std::max(so_far, std::fabs(weight)); });
  blocks.detail_unit = largest / float(INT16_MAX);
  auto* integers = arena.take<std::int16_t>(weights.size());
  std::transform(weights.begin(), weights.end(), integers,
                 [&](float weight) { return std::int16_t(std::lround(weight / blocks.detail_unit)); });
  blocks.detail_weight = integers;
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
  std::vector<std::int32_t> row(std::size_t(g.nodes));  // of each garment node of a block
  for (int i = 0; i < g.vertex_count; ++i) {
    const int block = i / kBlock, lane = i % kBlock;
    if (lane == 0) {
      for (std::int32_t at = start[block]; at < start[block + 1]; ++at) row[nodes[at]] = at;
    }
    const std::size_t v = order[i];
    vertex[i] = order[i];
    for (int c = 0; c < 3; ++c) {
      rest[(std::size_t(block) * 6 + c) * kBlock + lane] = g.vertices[3 * v + c];
      rest[(std::size_t(block) * 6 + 3 + c) * kBlock + lane] = g.normals[3 * v + c];
    }
    for (std::size_t at = v * g.influences; at < (v + 1) * g.influences; ++at) {
      const float weight = g.influence_weights[at];
      if (weight == 0.0f) continue;
      weights[std::size_t(row[g.influence_nodes[at]]) * kBlock + lane] += weight;  // a node may be listed twice
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

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
#include "kernels/shared.hpp"

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
  NodeSet nodes;                  // of the vertices, all together
  std::array<int, 4> loops = {};  // garment nodes and detail nodes of all, and both of the first half
};

// Whether a node is one of the first half of a block's vertices, and of the second.
struct Halves {
  bool in[2] = {};
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
    put_together_first_half(block);
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

  // Puts those vertices first that go with the first one at the least work.
  void put_together_first_half(Block& block) {
    const auto end = block.vertices.end();
    for (auto next = block.vertices.begin(); next != end && next - block.vertices.begin() < kHalf; ++next) {
      const auto added = [&](std::int32_t vertex) {
        return std::accumulate(sets_[vertex].begin(), sets_[vertex].end(), 0,
                               [&](int sum, std::int32_t node) { return in_block_[node] ? sum : sum + cost(node); });
      };
      if (next != block.vertices.begin()) {
        std::vector<int> work(std::size_t(end - next));
        std::transform(next, end, work.begin(), added);
        std::iter_swap(next, next + (std::min_element(work.begin(), work.end()) - work.begin()));
      }
      for (const std::int32_t node : sets_[*next]) in_block_[node] = true;
    }
    for (const std::int32_t node : block.nodes) {
      const int kind = node >= nodes_;
      ++block.loops[kind];
      block.loops[2 + kind] += in_block_[node];
      in_block_[node] = false;
    }
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
  BlockChooser chooser(sets, curve_positions(g), g.nodes, g.has_detail() ? g.detail_numbers / 3 : 0);
  std::vector<Block> blocks;
  while (!chooser.done()) blocks.push_back(chooser.choose());
  if (blocks.empty()) return blocks;
  // Blocks of equal size follow each other, so that the processor foresees where loops over nodes end. The last one,
  // which may be short of vertices, stays last.
  std::stable_sort(blocks.begin(), blocks.end() - 1, [](const Block& a, const Block& b) { return a.loops < b.loops; });
  return blocks;
}

// What vertices have of one kind of node, row by row.
struct Influences {
  int count;  // a vertex
  const std::int32_t* nodes;
  const float* weights;
};

// Nodes of all blocks, in the order that kernels read them, and the weights of a block's vertices.
struct PackedNodes {
  std::vector<NodeRange> halves;
  std::vector<std::int32_t> nodes;
  std::vector<float> weights;
};

// order: vertices, block by block. at_least_one: a half has a node even if none has a weight there.
PackedNodes pack_nodes(const Influences& of, const std::vector<std::int32_t>& order, bool at_least_one) {
  PackedNodes packed;
  for (std::size_t first = 0; first < order.size(); first += kBlock) {
    const std::size_t count = std::min<std::size_t>(kBlock, order.size() - first);
    std::map<std::int32_t, std::array<float, kBlock>> of_nodes;
    std::map<std::int32_t, Halves> halves;
    for (std::size_t lane = 0; lane < count; ++lane) {
      const std::size_t at = std::size_t(order[first + lane]) * std::size_t(of.count);
      for (int k = 0; k < of.count; ++k) {
        const float weight = of.weights[at + k];
        if (weight == 0.0f) continue;
        of_nodes[of.nodes[at + k]][lane] += weight;  // a node may be listed twice
        halves[of.nodes[at + k]].in[lane / kHalf] = true;
      }
    }
    if (at_least_one && of_nodes.empty()) of_nodes[0] = {};
    const auto start = std::int32_t(packed.nodes.size());
    std::int32_t begin[2] = {start, start}, end[2] = {start, start};
    for (const Halves wanted : {Halves{{true, false}}, Halves{{true, true}}, Halves{{false, true}}, Halves{}}) {
      for (const auto& [node, weights] : of_nodes) {
        const Halves found = halves[node];
        if (found.in[0] != wanted.in[0] || found.in[1] != wanted.in[1]) continue;
        packed.nodes.push_back(node);
        packed.weights.insert(packed.weights.end(), weights.begin(), weights.end());
      }
      const auto now = std::int32_t(packed.nodes.size());
      if (wanted.in[0]) end[0] = now;
      if (!wanted.in[1] && wanted.in[0]) begin[1] = now;
      if (wanted.in[1]) end[1] = now;
    }
    for (int half = 0; half < 2; ++half) {
      if (end[half] <= begin[half]) {
        begin[half] = at_least_one ? std::int32_t(packed.nodes.size()) - 1 : begin[half];
        end[half] = begin[half] + at_least_one;
      }
      packed.halves.push_back({begin[half], end[half]});
    }
  }
  return packed;
}

// In 16 bits.
const std::int16_t* rounded(const std::vector<float>& weights, float unit, Arena& arena) {
  auto* integers = arena.take<std::int16_t>(weights.size());
  std::transform(weights.begin(), weights.end(), integers,
                 [&](float weight) { return std::int16_t(std::lround(weight / unit)); });
  return integers;
}

// What body wears them matters to the rest shape of blocks alone, which is left out here.
SkinningBlocks pack_influences(const SkinningData& g, BlockOrder wanted, Arena& arena) {
  SkinningBlocks blocks;
  blocks.vertex_count = g.vertex_count;
  blocks.block_count = (g.vertex_count + kBlock - 1) / kBlock;

  std::vector<std::int32_t> order;
  if (wanted == BlockOrder::kAsGiven) {
    order.resize(std::size_t(g.vertex_count));
    std::iota(order.begin(), order.end(), 0);
  } else {
    for (const Block& block : choose_blocks(g)) {
      order.insert(order.end(), block.vertices.begin(), block.vertices.end());
    }
  }
  auto* vertex = arena.take<std::int32_t>(std::size_t(blocks.block_count) * kBlock);
  std::copy(order.begin(), order.end(), vertex);
  blocks.vertex = vertex;

  PackedNodes nodes = pack_nodes({g.influences, g.influence_nodes, g.influence_weights}, order, true);
  for (std::int32_t& node : nodes.nodes) node *= 12;
  blocks.influences = arena.copy(nodes.halves.data(), nodes.halves.size());
  blocks.influence_matrix = arena.copy(nodes.nodes.data(), nodes.nodes.size());
  blocks.influence_weight = arena.copy(nodes.weights.data(), nodes.weights.size());
  if (!g.has_detail()) return blocks;
  PackedNodes details = pack_nodes({g.detail_influences, g.detail_nodes, g.detail_weights}, order, false);
  for (std::int32_t& node : details.nodes) node *= 3;
  const float largest = std::accumulate(details.weights.begin(), details.weights.end(), FLT_MIN,
                                        [](float so_far, float weight) { return std::max(so_far, std::fabs(weight)); });
  blocks.details = arena.copy(details.halves.data(), details.halves.size());
  blocks.detail_offset = arena.copy(details.nodes.data(), details.nodes.size());
  blocks.detail_unit = largest / float(INT16_MAX);
  blocks.detail_weight = rounded(details.weights, blocks.detail_unit, arena);
  return blocks;
}

// The same once for all bodies: of what order and influences follow from.
SkinningBlocks pack_influences_once(const SkinningData& g, Arena& arena) {
  const auto vertices = std::size_t(g.vertex_count);
  Digest digest;
  digest.add(g.nodes).add(g.vertex_count).add(g.influences);
  digest.add(g.influence_nodes, vertices * std::size_t(g.influences));
  digest.add(g.influence_weights, vertices * std::size_t(g.influences));
  if (g.has_detail()) {
    digest.add(g.detail_influences).add(g.detail_numbers);
    digest.add(g.detail_nodes, vertices * std::size_t(g.detail_influences));
    digest.add(g.detail_weights, vertices * std::size_t(g.detail_influences));
  }
  return shared_in<SkinningBlocks>(arena, digest,
                                   [&](Arena& own) { return pack_influences(g, BlockOrder::kFewNodes, own); });
}

}  // namespace

SkinningBlocks pack_skinning_blocks(const SkinningData& g, Arena& arena, BlockOrder wanted) {
  SkinningBlocks blocks =
      wanted == BlockOrder::kFewNodes ? pack_influences_once(g, arena) : pack_influences(g, wanted, arena);
  auto* rest = arena.take<float>(std::size_t(blocks.block_count) * 6 * kBlock);
  for (int i = 0; i < g.vertex_count; ++i) {
    const int block = i / kBlock, lane = i % kBlock;
    const std::size_t v = std::size_t(blocks.vertex[i]);
    for (int c = 0; c < 3; ++c) {
      rest[(std::size_t(block) * 6 + c) * kBlock + lane] = g.vertices[3 * v + c];
      rest[(std::size_t(block) * 6 + 3 + c) * kBlock + lane] = g.normals == nullptr ? 0.0f : g.normals[3 * v + c];
    }
  }
  blocks.rest = rest;
  return blocks;
}

}  // namespace physkin

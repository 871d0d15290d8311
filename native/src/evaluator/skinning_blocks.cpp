// Which vertices the skinning kernel works on together.
#include <algorithm>
#include <array>
#include <cfloat>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <numeric>
#include <type_traits>
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
  BlockChooser chooser(sets, curve_positions(g.vertices, g.vertex_count), g.nodes,
                       g.has_detail() ? g.detail_numbers / 3 : 0);
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

struct Packed {
  PackedNodes light, heavy;
};

// order: vertices, block by block. Heavy are nodes that a vertex of the block goes with by more than `most`.
Packed pack_nodes(const Influences& of, const std::vector<std::int32_t>& order, float most = FLT_MAX) {
  Packed packed;
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
    for (const bool is_heavy : {false, true}) {
      PackedNodes& rows = is_heavy ? packed.heavy : packed.light;
      const auto start = std::int32_t(rows.nodes.size());
      NodeRange first_half{start, start}, second_half{start, start};
      for (const Halves wanted : {Halves{{true, false}}, Halves{{true, true}}, Halves{{false, true}}}) {
        for (const auto& [node, weights] : of_nodes) {
          const Halves found = halves[node];
          if (found.in[0] != wanted.in[0] || found.in[1] != wanted.in[1]) continue;
          if ((*std::max_element(weights.begin(), weights.end()) > most) != is_heavy) continue;
          rows.nodes.push_back(node);
          rows.weights.insert(rows.weights.end(), weights.begin(), weights.end());
        }
        const auto now = std::int32_t(rows.nodes.size());
        if (wanted.in[0]) first_half.end = now;
        if (!wanted.in[1]) second_half.begin = now;
        second_half.end = now;
      }
      rows.halves.insert(rows.halves.end(), {first_half, second_half});
    }
  }
  return packed;
}

// stride: from a node's matrix or offset to the next one's [floats]. unit: of whole weights.
template <class Start, class Weight>
NodeRows<Start, Weight> in_rows(const PackedNodes& packed, int stride, float unit, Arena& arena) {
  auto* start = arena.take<Start>(packed.nodes.size());
  auto* weight = arena.take<Weight>(packed.weights.size());
  std::transform(packed.nodes.begin(), packed.nodes.end(), start, [&](int node) { return Start(node * stride); });
  std::transform(packed.weights.begin(), packed.weights.end(), weight, [&](float given) {
    return std::is_integral_v<Weight> ? Weight(std::lround(given / unit)) : Weight(given);
  });
  return {arena.copy(packed.halves.data(), packed.halves.size()), start, weight};
}

// Weights as whole numbers of a unit. Those of a vertex sum to what they do, rounded: one, where they sum to one, as a
// vertex that goes with a little more than all of its nodes would be off the mesh.
struct WholeWeights {
  std::vector<float> weights;
  float unit;
};

// So many units to the largest sum of a vertex's weights; by the largest remainders.
WholeWeights whole_weights(const float* weights, int vertices, int count, int units) {
  WholeWeights whole{std::vector<float>(std::size_t(vertices) * std::size_t(count)), FLT_MIN};
  const auto row = [&](int vertex) { return weights + std::ptrdiff_t(vertex) * count; };
  for (int v = 0; v < vertices; ++v) whole.unit = std::max(whole.unit, std::accumulate(row(v), row(v) + count, 0.0f));
  whole.unit /= float(units);
  std::vector<int> by_remainder(static_cast<std::size_t>(count));
  std::vector<float> remainder(static_cast<std::size_t>(count));
  for (int v = 0; v < vertices; ++v) {
    float* target = whole.weights.data() + std::ptrdiff_t(v) * count;
    float sum = 0;
    long missing = 0;
    for (int k = 0; k < count; ++k) {
      const float wanted = row(v)[k] / whole.unit;
      target[k] = std::round(wanted);
      remainder[k] = wanted - target[k];
      sum += wanted;
      missing -= long(target[k]);
    }
    missing += std::lround(sum);
    if (missing == 0) continue;
    const float step = missing > 0 ? 1.0f : -1.0f;
    std::iota(by_remainder.begin(), by_remainder.end(), 0);
    std::sort(by_remainder.begin(), by_remainder.end(),
              [&](int a, int b) { return step * remainder[a] > step * remainder[b]; });
    for (long k = 0; k < std::labs(missing); ++k) target[by_remainder[k]] += step;
  }
  return whole;
}

// Model files hold garment nodes' weights in these units: they are rounded no more.
constexpr int kUnits = 4095, kByte = 255;

// Whether numbers of 16 bits, and none below zero, are enough.
bool fits_narrow_rows(const SkinningData& g) {
  constexpr int kMost = 1 << 16;
  const auto is_signed = [](const float* weights, std::size_t count) {
    return std::any_of(weights, weights + count, [](float weight) { return weight < 0; });
  };
  return g.vertex_count <= kMost && g.nodes <= kMost / 12 &&
         !is_signed(g.influence_weights, std::size_t(g.vertex_count) * std::size_t(g.influences)) &&
         (!g.has_detail() ||
          (g.detail_numbers <= kMost &&
           !is_signed(g.detail_weights, std::size_t(g.vertex_count) * std::size_t(g.detail_influences))));
}

std::vector<std::int32_t> order_of_blocks(const SkinningData& g, BlockOrder wanted) {
  std::vector<std::int32_t> order;
  if (wanted == BlockOrder::kAsGiven) {
    order.resize(std::size_t(g.vertex_count));
    std::iota(order.begin(), order.end(), 0);
  } else {
    for (const Block& block : choose_blocks(g)) {
      order.insert(order.end(), block.vertices.begin(), block.vertices.end());
    }
  }
  return order;
}

// (blocks, 3, kBlock) of points (vertices, 3), or zeros.
template <class Number>
Number* in_blocks(const Number* points, const std::vector<std::int32_t>& order, int block_count, Arena& arena) {
  auto* columns = arena.take<Number>(std::size_t(block_count) * 3 * kBlock);
  for (std::size_t i = 0; points != nullptr && i < order.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      columns[(i / kBlock * 3 + c) * kBlock + i % kBlock] = points[3 * std::size_t(order[i]) + c];
    }
  }
  return columns;
}

// In 16 bits: of a garment of a metre, to 0.01 mm.
void round_rest(const SkinningData& g, const std::vector<std::int32_t>& order, NarrowRows& rows, int block_count,
                Arena& arena) {
  for (int c = 0; c < 3; ++c) {
    float low = g.vertices[c], high = low;
    for (int v = 0; v < g.vertex_count; ++v) {
      low = std::min(low, g.vertices[3 * v + c]);
      high = std::max(high, g.vertices[3 * v + c]);
    }
    rows.rest_middle[c] = 0.5f * low + 0.5f * high;
    rows.rest_unit = std::max({rows.rest_unit, FLT_MIN, (0.5f * high - 0.5f * low) / float(INT16_MAX)});
  }
  std::vector<std::int16_t> rounded(3 * std::size_t(g.vertex_count));
  for (std::size_t at = 0; at < rounded.size(); ++at) {
    rounded[at] = std::int16_t(std::lround((g.vertices[at] - rows.rest_middle[at % 3]) / rows.rest_unit));
  }
  rows.rest = in_blocks(rounded.data(), order, block_count, arena);
}

template <class Index>
const Index* indices(const std::vector<std::int32_t>& order, int block_count, Arena& arena) {
  auto* target = arena.take<Index>(std::size_t(block_count) * kBlock);
  std::transform(order.begin(), order.end(), target, [](std::int32_t vertex) { return Index(vertex); });
  return target;
}

WideRows wide_rows(const SkinningData& g, const std::vector<std::int32_t>& order, SkinningBlocks& blocks,
                   Arena& arena) {
  WideRows rows;
  const Packed nodes = pack_nodes({g.influences, g.influence_nodes, g.influence_weights}, order);
  rows.influences = in_rows<std::int32_t, float>(nodes.light, 12, 1, arena);
  if (g.has_detail()) {
    const PackedNodes details = pack_nodes({g.detail_influences, g.detail_nodes, g.detail_weights}, order).light;
    const float largest =
        std::accumulate(details.weights.begin(), details.weights.end(), FLT_MIN,
                        [](float so_far, float weight) { return std::max(so_far, std::fabs(weight)); });
    blocks.detail_unit = largest / float(INT16_MAX);
    rows.details = in_rows<std::int32_t, std::int16_t>(details, 3, blocks.detail_unit, arena);
  }
  rows.rest = in_blocks(g.vertices, order, blocks.block_count, arena);
  rows.vertex = indices<std::int32_t>(order, blocks.block_count, arena);
  return rows;
}

NarrowRows narrow_rows(const SkinningData& g, const std::vector<std::int32_t>& order, int block_count, Arena& arena) {
  NarrowRows rows;
  const Packed nodes = pack_nodes({g.influences, g.influence_nodes, g.influence_weights}, order, kByte);
  rows.heavy_influences = in_rows<std::uint16_t, std::int16_t>(nodes.heavy, 12, 1, arena);
  rows.influences = in_rows<std::uint16_t, std::uint8_t>(nodes.light, 12, 1, arena);
  if (g.has_detail()) {
    const Packed details = pack_nodes({g.detail_influences, g.detail_nodes, g.detail_weights}, order);
    rows.details = in_rows<std::uint16_t, std::uint8_t>(details.light, 3, 1, arena);
  }
  round_rest(g, order, rows, block_count, arena);
  rows.vertex = indices<std::uint16_t>(order, block_count, arena);
  return rows;
}

}  // namespace

SkinningBlocks pack_skinning_blocks(const SkinningData& given, Arena& arena, BlockOrder wanted, Precision precision) {
  SkinningData g = given;
  SkinningBlocks blocks;
  blocks.vertex_count = g.vertex_count;
  blocks.block_count = (g.vertex_count + kBlock - 1) / kBlock;
  blocks.is_narrow = precision != Precision::fp32 && fits_narrow_rows(g);
  WholeWeights whole, whole_details;
  if (blocks.is_narrow) {
    whole = whole_weights(g.influence_weights, g.vertex_count, g.influences, kUnits);
    g.influence_weights = whole.weights.data();
    blocks.unit = whole.unit;
    if (g.has_detail()) {
      whole_details = whole_weights(g.detail_weights, g.vertex_count, g.detail_influences, kByte);
      g.detail_weights = whole_details.weights.data();
      blocks.detail_unit = whole_details.unit;
    }
  }
  const std::vector<std::int32_t> order = order_of_blocks(g, wanted);
  if (blocks.is_narrow) {
    blocks.narrow = narrow_rows(g, order, blocks.block_count, arena);
  } else {
    blocks.wide = wide_rows(g, order, blocks, arena);
  }
  blocks.normals = in_blocks(g.normals, order, blocks.block_count, arena);
  return blocks;
}

}  // namespace physkin

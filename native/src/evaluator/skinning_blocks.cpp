// Which vertices the skinning kernel works on together.
#include <algorithm>
#include <array>
#include <cfloat>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <type_traits>
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

struct Packed {
  PackedNodes light, heavy;
};

struct NodeRow {
  std::int32_t node;
  std::array<float, kBlock> weights;

  float heaviest() const { return *std::max_element(weights.begin(), weights.end()); }
  NodeRow up_to(float most) const {
    NodeRow row = *this;
    for (float& weight : row.weights) weight = std::min(weight, most);
    return row;
  }
  NodeRow beyond(float most) const {
    NodeRow row = *this;
    for (float& weight : row.weights) weight -= std::min(weight, most);
    return row;
  }
  bool in(int half) const {
    const auto first = weights.begin() + half * kHalf;
    return std::any_of(first, first + kHalf, [](float weight) { return weight != 0; });
  }
};

// Of vertices that lie in one block, in order of the nodes.
std::vector<NodeRow> rows_of(const Influences& of, const std::int32_t* vertices, std::size_t count) {
  std::map<std::int32_t, std::array<float, kBlock>> of_nodes;
  for (std::size_t lane = 0; lane < count; ++lane) {
    const std::size_t at = std::size_t(vertices[lane]) * std::size_t(of.count);
    // A node may be listed twice.
    for (int k = 0; k < of.count; ++k) of_nodes[of.nodes[at + k]][lane] += of.weights[at + k];
  }
  std::vector<NodeRow> rows;
  for (const auto& [node, weights] : of_nodes) rows.push_back({node, weights});
  return rows;
}

void add_block(PackedNodes& packed, const std::vector<NodeRow>& rows) {
  const auto now = [&] { return std::int32_t(packed.nodes.size()); };
  const auto add = [&](bool in_first, bool in_second) {
    for (const NodeRow& row : rows) {
      if (row.in(0) != in_first || row.in(1) != in_second) continue;
      packed.nodes.push_back(row.node);
      packed.weights.insert(packed.weights.end(), row.weights.begin(), row.weights.end());
    }
  };
  NodeRange first{now(), 0}, second{};
  add(true, false);
  second.begin = now();
  add(true, true);
  first.end = now();
  add(false, true);
  second.end = now();
  packed.halves.insert(packed.halves.end(), {first, second});
}

// What to do with nodes that a vertex of the block goes with by more than `most`: they are heavy, or have another row for
// what is beyond.
enum class Beyond { kHeavy, kAnotherRow };

// order: vertices, block by block.
Packed pack_nodes(const Influences& of, const std::vector<std::int32_t>& order, float most = FLT_MAX,
                  Beyond beyond = Beyond::kHeavy) {
  Packed packed;
  for (std::size_t first = 0; first < order.size(); first += kBlock) {
    std::vector<NodeRow> light, heavy;
    for (NodeRow row : rows_of(of, order.data() + first, std::min<std::size_t>(kBlock, order.size() - first))) {
      if (beyond == Beyond::kHeavy && row.heaviest() > most) {
        heavy.push_back(row);
        continue;
      }
      for (; row.heaviest() > most; row = row.beyond(most)) light.push_back(row.up_to(most));
      light.push_back(row);
    }
    add_block(packed.light, light);
    add_block(packed.heavy, heavy);
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

// Steps to one of garment nodes' and of detail nodes' weights, as model files hold them.
constexpr int kSteps = 4095, kDetailSteps = 511;

// Weights of each vertex as whole numbers of so many steps to one: no vector where they are not, but for how floats are
// rounded, or sum to more.
std::optional<std::vector<float>> in_steps(const float* weights, int vertices, int count, int steps) {
  constexpr float kRounding = 1.0f / 256;
  std::vector<float> whole;
  for (const float *row = weights, *end = row + std::ptrdiff_t(vertices) * count; row != end; row += count) {
    float sum = 0;
    for (int k = 0; k < count; ++k) {
      const float exact = row[k] * float(steps), step = std::round(exact);
      if (!(exact >= 0) || !(std::fabs(exact - step) < kRounding) || (sum += step) > float(steps)) return {};
      whole.push_back(step);
    }
  }
  return whole;
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

template <class Index>
const Index* indices(const std::vector<std::int32_t>& order, int block_count, Arena& arena) {
  auto* target = arena.take<Index>(std::size_t(block_count) * kBlock);
  std::transform(order.begin(), order.end(), target, [](std::int32_t vertex) { return Index(vertex); });
  return target;
}

void pack_wide(const SkinningData& g, const std::vector<std::int32_t>& order, SkinningBlocks& blocks, Arena& arena) {
  const Packed nodes = pack_nodes({g.influences, g.influence_nodes, g.influence_weights}, order);
  blocks.wide.influences = in_rows<std::int32_t, float>(nodes.light, 12, 1, arena);
  blocks.wide.vertex = indices<std::int32_t>(order, blocks.block_count, arena);
  if (!g.has_detail()) return;
  const PackedNodes details = pack_nodes({g.detail_influences, g.detail_nodes, g.detail_weights}, order).light;
  const float largest = std::accumulate(details.weights.begin(), details.weights.end(), FLT_MIN,
                                        [](float so_far, float weight) { return std::max(so_far, std::fabs(weight)); });
  blocks.detail_unit = largest / float(INT16_MAX);
  blocks.wide.details = in_rows<std::int32_t, std::int16_t>(details, 3, blocks.detail_unit, arena);
}

// False, and nothing packed, where weights are no whole steps, or indices too large.
bool pack_narrow(const SkinningData& g, const std::vector<std::int32_t>& order, SkinningBlocks& blocks, Arena& arena) {
  constexpr int kMost = 1 << 16;
  const int detail_influences = g.has_detail() ? g.detail_influences : 0;
  if (g.vertex_count > kMost - kRingGroup || 12 * std::int64_t(g.nodes) > kMost ||
      (g.has_detail() && g.detail_numbers > kMost)) {
    return false;
  }
  const auto weights = in_steps(g.influence_weights, g.vertex_count, g.influences, kSteps);
  const auto details = in_steps(g.detail_weights, g.vertex_count, detail_influences, kDetailSteps);
  if (!weights || !details) return false;
  const Packed nodes = pack_nodes({g.influences, g.influence_nodes, weights->data()}, order, UINT8_MAX);
  blocks.unit = 1.0f / kSteps;
  blocks.narrow.heavy_influences = in_rows<std::uint16_t, std::int16_t>(nodes.heavy, 12, 1, arena);
  blocks.narrow.influences = in_rows<std::uint16_t, std::uint8_t>(nodes.light, 12, 1, arena);
  blocks.narrow.vertex = indices<std::uint16_t>(order, blocks.block_count, arena);
  if (!g.has_detail()) return true;
  const Packed of_details =
      pack_nodes({detail_influences, g.detail_nodes, details->data()}, order, UINT8_MAX, Beyond::kAnotherRow);
  blocks.detail_unit = 1.0f / kDetailSteps;
  blocks.narrow.details = in_rows<std::uint16_t, std::uint8_t>(of_details.light, 3, 1, arena);
  return true;
}

// What body wears them matters to the rest shape of blocks alone, which is left out here.
SkinningBlocks pack_influences(const SkinningData& g, BlockOrder wanted, Arena& arena) {
  SkinningBlocks blocks;
  blocks.vertex_count = g.vertex_count;
  blocks.block_count = (g.vertex_count + kBlock - 1) / kBlock;
  const std::vector<std::int32_t> order = order_of_blocks(g, wanted);
  blocks.is_narrow = pack_narrow(g, order, blocks, arena);
  if (!blocks.is_narrow) pack_wide(g, order, blocks, arena);
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

// (blocks, 3, kBlock) of points (vertices, 3), or zeros.
const float* in_blocks(const float* points, const SkinningBlocks& blocks, Arena& arena) {
  auto* columns = arena.take<float>(std::size_t(blocks.block_count) * 3 * kBlock);
  for (int i = 0; points != nullptr && i < blocks.vertex_count; ++i) {
    const std::size_t vertex = blocks.is_narrow ? blocks.narrow.vertex[i] : std::size_t(blocks.wide.vertex[i]);
    for (int c = 0; c < 3; ++c)
      columns[(i / kBlock * 3 + c) * kBlock + i % kBlock] = points[3 * vertex + std::size_t(c)];
  }
  return columns;
}

}  // namespace

SkinningBlocks pack_skinning_blocks(const SkinningData& g, Arena& arena, BlockOrder wanted) {
  SkinningBlocks blocks =
      wanted == BlockOrder::kFewNodes ? pack_influences_once(g, arena) : pack_influences(g, wanted, arena);
  blocks.rest = in_blocks(g.vertices, blocks, arena);
  blocks.normals = in_blocks(g.normals, blocks, arena);
  return blocks;
}

}  // namespace physkin

#include "evaluator/contact.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include "evaluator/skinner.hpp"

namespace physkin {
namespace {

// [m] What lies between samples is looked at where one lacks so much, and counts in full where it lacks twice as much.
constexpr float kLooks = 0.003f;
// [m] What samples that lack nothing hold a node back as if they lacked.
constexpr float kSlack = 0.0003f;
// What a sample lacks is its nodes' part only: the second time sees what the first has left.
constexpr int kPasses = 2;
// Of two places of the cloth each makes up for its part of what is lacking.
constexpr float kOwnShare = 0.5f;
// [m] Samples that lack less stay.
constexpr float kLeast = 1e-5f;
// Where skinning makes less of a volume than this, detail is moved as if it were this.
constexpr float kFlattened = 0.3f;

SkinningData as_vertices(const BoundGarment& g) {
  const ClothSampling& of = g.contact;
  SkinningData data;
  data.nodes = g.nodes;
  data.vertex_count = of.samples;
  data.influences = of.influences;
  data.node_rest = g.node_rest;
  data.vertices = of.vertices;
  data.normals = of.normals;
  data.influence_nodes = of.influence_nodes;
  data.influence_weights = of.influence_weights;
  data.detail_vertices = of.detail_influences > 0 ? of.samples : 0;
  data.detail_influences = of.detail_influences;
  data.detail_numbers = g.detail_numbers;
  data.detail_nodes = of.detail_nodes;
  data.detail_weights = of.detail_weights;
  return data;
}

typedef float Four __attribute__((vector_size(16)));

Four load_four(const float* from) {
  Four four;
  std::memcpy(&four, from, sizeof four);
  return four;
}

template <class Value>
std::vector<Value> joined(const Value* first, int count, const Value* second = nullptr, int more = 0) {
  std::vector<Value> both(first, first + count);
  both.insert(both.end(), second, second + more);
  return both;
}

}  // namespace

Contact::Movers::Movers(int count, int each, const std::vector<std::int32_t>& nodes, const std::vector<float>& weights,
                        Arena& arena)
    : count(count),
      each(each),
      nodes(arena.copy(nodes.data(), nodes.size())),
      weights(arena.copy(weights.data(), weights.size())),
      slack(arena.take<float>(std::size_t(count))),
      moves(arena.take<Four>(std::size_t(count))),
      sums(arena.take<Four>(std::size_t(count))) {
  for (std::size_t at = 0; at < nodes.size(); ++at) slack[nodes[at]] += kSlack * weights[at];
}

inline Contact::Four Contact::Movers::moved(int sample) const noexcept {
  Four by = {};
  for (int at = each * sample; at < each * (sample + 1); ++at) by += weights[at] * moves[nodes[at]];
  return by;
}

Contact::Contact(const BoundGarment& g, const Kernels& kernels, Arena& arena)
    : kernels_(kernels),
      node_count_(g.nodes),
      samples_(g.contact.samples),
      between_(g.between),
      blocks_(pack_skinning_blocks(as_vertices(g), arena, BlockOrder::kAsGiven)),
      skin_rooms_(SkinSurface::rooms(g)),
      heights_(arena.copy(g.between_heights, std::size_t(between_))),
      block_of_(arena.copy(g.between_blocks, std::size_t(g.between_block_count))),
      node_rest_(arena.copy(g.node_rest, 3 * std::size_t(g.nodes))),
      matrices_(arena.take<float>(12 * std::size_t(g.nodes))),
      rows_(arena.take<float>(std::size_t(kSkinRow * kBlock * blocks_.block_count))),
      between_rows_(arena.take<float>(kSkinRow * kBlock)),
      planes_(arena.take<float>(5 * kBlock)),
      room_{arena.take<std::uint64_t>(2 * std::size_t(skin_rooms_ / 64 + 1)),
            arena.take<std::int32_t>(std::size_t(skin_rooms_ + 1)),
            arena.take<std::int32_t>(std::size_t(skin_rooms_ * (kSkinBlock + 1) + 2)),
            arena.take<float>(std::size_t((skin_rooms_ + 1) * kBlock)),
            arena.take<float>(std::size_t(kSkinBlock * skin_rooms_ * kBlock))},
      own_count_(g.touching),
      own_{own_count_ / kBlock, (own_count_ / kBlock + kBlock - 1) / kBlock * kBlock,
           arena.copy(g.touching_samples, std::size_t(own_count_)), rows_,
           arena.take<float>(6 * std::size_t(own_count_))},
      own_gaps_(arena.copy(g.touching_gaps, std::size_t(own_count_))),
      hangs_(arena.copy(g.contact_hangs, std::size_t(samples_))),
      garment_nodes_(g.nodes, g.contact.influences, joined(g.contact.influence_nodes, samples_ * g.contact.influences),
                     joined(g.contact.influence_weights, samples_ * g.contact.influences), arena),
      detail_nodes_(g.contact.detail_influences > 0 ? g.detail_numbers / 3 : 0, g.contact.detail_influences,
                    joined(g.contact.detail_nodes, samples_ * g.contact.detail_influences, g.between_nodes,
                           between_ * g.contact.detail_influences),
                    joined(g.contact.detail_weights, samples_ * g.contact.detail_influences, g.between_weights,
                           between_ * g.contact.detail_influences),
                    arena),
      most_(arena.take<float>(std::size_t(g.between_block_count))),
      near_(arena.take<Near>(std::size_t(measured()))),
      offsets_(arena.take<float>(3 * std::size_t(detail_nodes_.count))) {
  const int skin_blocks = g.skin_points / kSkinBlock;
  auto* sides = arena.take<std::int16_t>(std::size_t(blocks_.block_count) * std::size_t(skin_rooms_));
  for (int block = 0; block < blocks_.block_count; ++block) {
    for (int k = 0; k < skin_blocks; ++k) {
      sides[block * skin_rooms_ + k] = std::int16_t(g.contact_sides[std::ptrdiff_t(block) * skin_blocks + k]);
    }
  }
  sides_ = sides;
  own_.boxes = arena.take<float>(6 * std::size_t(own_.rooms));
  own_.listed = arena.take<float>(std::size_t(kSkinRow * own_count_));
  auto* own_sides = arena.take<std::int16_t>(std::size_t(own_.count * own_.rooms));
  for (int k = 0; k < own_.count * own_.count; ++k) {
    own_sides[k / own_.count * own_.rooms + k % own_.count] = std::int16_t(g.touching_sides[k]);
  }
  own_sides_ = own_sides;
  auto* gaps = arena.take<float>(std::size_t(samples_ + between_));
  std::copy_n(g.contact_gaps, samples_, gaps);
  std::copy_n(g.between_gaps, between_, gaps + samples_);
  gaps_ = gaps;
  if (detail_nodes_.count > 0) find_samples_around(arena);
}

void Contact::find_samples_around(Arena& arena) {
  const auto& [count, each, nodes, weights, slack, moves, sums] = detail_nodes_;
  auto* sample_of = arena.take<std::int32_t>(std::size_t(count));
  std::vector<float> most(std::size_t(count), 0.0f);
  for (int at = 0; at < samples_ * each; ++at) {
    if (!(weights[at] > most[std::size_t(nodes[at])])) continue;
    most[std::size_t(nodes[at])] = weights[at];
    sample_of[nodes[at]] = at / each;
  }
  sample_of_ = sample_of;
  std::vector<std::vector<std::int32_t>> blocks(static_cast<std::size_t>(samples_));
  for (int at = each * samples_; at < each * (samples_ + between_); ++at) {
    std::vector<std::int32_t>& of_sample = blocks[std::size_t(sample_of[nodes[at]])];
    const int block = (at / each - samples_) / kBlock;
    if (weights[at] > 0 && (of_sample.empty() || of_sample.back() != block)) of_sample.push_back(block);
  }
  std::vector<std::int32_t> starts{0}, around;
  for (const std::vector<std::int32_t>& of_sample : blocks) {
    around.insert(around.end(), of_sample.begin(), of_sample.end());
    starts.push_back(std::int32_t(around.size()));
  }
  around_start_ = arena.copy(starts.data(), starts.size());
  around_ = arena.copy(around.data(), around.size());
}

const float* Contact::keep_out(const SkinBlocks& skin, float* node_transforms, const float* offsets) noexcept {
  place(node_transforms, offsets);
  near_count_ = blocks_between_ = 0;
  for (int first = 0; first < samples_; first += kBlock) {
    if (!meet(skin, rows_ + kSkinRow * first, first / kBlock)) continue;
    for (int s = first; s < std::min(first + kBlock, samples_); ++s) list(s, s - first, gaps_[s], 1);
  }
  const bool has_detail = detail_nodes_.count > 0;
  if (move(garment_nodes_, has_detail ? hangs_ : nullptr)) move_garment_nodes(node_transforms);
  if (!has_detail) return offsets;
  look_between(skin);
  meet_itself([this](int own, int place) { list(own_.samples[own], place, own_gaps_[own], kOwnShare); });
  if (!move(detail_nodes_, nullptr)) return offsets;
  std::copy_n(offsets, 3 * detail_nodes_.count, offsets_);
  for (int node = 0; node < detail_nodes_.count; ++node) {
    const Four* moves = detail_nodes_.moves;
    const Vector3 by{moves[node][0], moves[node][1], moves[node][2]};
    if (!(dot(by, by) > kLeast * kLeast)) continue;
    const Vector3 at_rest = turned_back(node, by);
    offsets_[3 * node] += at_rest.x;
    offsets_[3 * node + 1] += at_rest.y;
    offsets_[3 * node + 2] += at_rest.z;
  }
  return offsets_;
}

void Contact::measure(const SkinBlocks& skin, const float* node_transforms, const float* offsets,
                      float* clearance) noexcept {
  place(node_transforms, offsets);
  std::fill_n(clearance, measured(), kNoSkin);
  const auto read = [&](bool any, int first, int end) {
    for (int s = first; any && s < end; ++s) {
      if (planes_[4 * kBlock + s - first] > 0) clearance[s] = planes_[s - first];
    }
  };
  for (int first = 0; first < samples_; first += kBlock) {
    read(meet(skin, rows_ + kSkinRow * first, first / kBlock), first, std::min(first + kBlock, samples_));
  }
  for (int first = 0; first < between_; first += kBlock) {
    place_between(first / kBlock);
    read(meet(skin, between_rows_, block_of_[first / kBlock]), samples_ + first,
         samples_ + std::min(first + kBlock, between_));
  }
  meet_itself([&](int own, int place) {
    if (planes_[4 * kBlock + place] > 0) clearance[samples_ + between_ + own] = planes_[place];
  });
}

std::size_t Contact::untouched() const noexcept {
  const std::size_t between = std::size_t(std::max(between_ - kBlock * blocks_between_, 0));
  const std::size_t each = std::size_t(detail_nodes_.each) * (sizeof(std::int32_t) + sizeof(float)) + 2 * sizeof(float);
  std::size_t bytes = between * each + std::size_t(measured() - near_count_) * sizeof(Near);
  if (near_count_ == 0) {
    for (const Movers* movers : {&garment_nodes_, &detail_nodes_}) {
      bytes += std::size_t(movers->count) * (sizeof(float) + 2 * sizeof(Four));
    }
  }
  return bytes;
}

void Contact::place(const float* node_transforms, const float* offsets) noexcept {
  skinning_matrices(node_transforms, node_rest_, node_count_, matrices_);
  kernels_.skin(blocks_, matrices_, offsets, {reinterpret_cast<unsigned char*>(rows_), kSkinRow, true});
}

bool Contact::meet(const SkinBlocks& skin, const float* rows, int block) noexcept {
  return kernels_.meet_skin(skin, rows, sides_ + std::ptrdiff_t(block) * skin_rooms_, room_, planes_);
}

void Contact::list(int sample, int place, float gap, float share) noexcept {
  const float* plane = planes_ + place;
  const float lacks = gap + kSoft - plane[0], holds = share * plane[4 * kBlock];
  if (!(holds > 0) || !(lacks > 0)) return;
  near_[near_count_++] = Near{Four{plane[kBlock], plane[2 * kBlock], plane[3 * kBlock], 0}, sample, lacks, 0, holds};
}

template <class Met>
void Contact::meet_itself(Met met) noexcept {
  if (own_.count == 0) return;
  kernels_.bound_cloth(own_);
  for (int block = 0; block < own_.count; ++block) {
    if (!kernels_.meet_cloth(own_, block, own_sides_ + block * own_.rooms, planes_)) continue;
    for (int place = 0; place < kBlock; ++place) met(kBlock * block + place, place);
  }
}

float Contact::lack_of(const Near& near) const noexcept {
  return near.holds * soft_push(std::max(near.lacks - near.moved, 0.0f), kSoft);
}

// What lacks more counts more, so that a sample that hardly lacks anything does not hold back one beside it.
bool Contact::move(Movers& movers, const float* shares) noexcept {
  bool moved = false;
  for (int pass = 0; pass < kPasses; ++pass) {
    bool any = false;
    for (int k = 0; k < near_count_; ++k) {
      const Near& near = near_[k];
      const float lack = (shares == nullptr ? 1 : shares[near.sample]) * lack_of(near);
      if (!(lack > kLeast)) continue;
      if (!any) std::fill_n(movers.sums, movers.count, Four{});
      any = true;
      const Four counted = lack * (lack * near.normal + Four{0, 0, 0, 1});
      for (int at = movers.each * near.sample; at < movers.each * (near.sample + 1); ++at) {
        movers.sums[movers.nodes[at]] += movers.weights[at] * counted;
      }
    }
    if (!any) break;
    if (!moved) std::fill_n(movers.moves, movers.count, Four{});
    moved = true;
    for (int node = 0; node < movers.count; ++node) {
      const Four sum = movers.sums[node];
      if (sum[3] > 0) movers.moves[node] += 1 / (sum[3] + movers.slack[node]) * sum;
    }
    for (int k = 0; k < near_count_; ++k) {
      const Four by = near_[k].normal * movers.moved(near_[k].sample);
      near_[k].moved = by[0] + by[1] + by[2];
    }
  }
  return moved;
}

void Contact::move_garment_nodes(float* node_transforms) noexcept {
  for (int i = 0; i < node_count_; ++i) {
    for (int c = 0; c < 3; ++c) node_transforms[12 * i + 4 * c + 3] += garment_nodes_.moves[i][c];
  }
  for (int sample = 0; sample < samples_; ++sample) {
    const Four by = garment_nodes_.moved(sample);
    for (int c = 0; c < 3; ++c) rows_[kSkinRow * sample + c] += by[c];
  }
  for (int k = 0; k < near_count_; ++k) {
    near_[k].lacks -= near_[k].moved;
    near_[k].moved = 0;
  }
}

void Contact::look_between(const SkinBlocks& skin) noexcept {
  if (between_ == 0) return;
  const int blocks = (between_ + kBlock - 1) / kBlock;
  bool any = false;
  std::fill_n(most_, blocks, 0.0f);
  for (int k = 0; k < near_count_; ++k) {
    const float lack = lack_of(near_[k]);
    if (!(lack > kLooks)) continue;
    any = true;
    const std::int32_t* of_sample = around_start_ + near_[k].sample;
    for (int at = of_sample[0]; at < of_sample[1]; ++at) most_[around_[at]] = std::max(most_[around_[at]], lack);
  }
  if (!any) return;
  for (int block = 0; block < blocks; ++block) {
    if (!(most_[block] > kLooks)) continue;
    ++blocks_between_;
    place_between(block);
    const int first = samples_ + kBlock * block;
    if (!meet(skin, between_rows_, block_of_[block])) continue;
    const float share = std::min(most_[block] / kLooks - 1, 1.0f);
    for (int s = first; s < std::min(first + kBlock, samples_ + between_); ++s) list(s, s - first, gaps_[s], share);
  }
}

// Detail nodes give way to each other linearly, and so do the samples that go with them.
void Contact::place_between(int block) noexcept {
  const int first = kBlock * block, each = detail_nodes_.each;
  for (int lane = 0; lane < kBlock; ++lane) {
    const int s = std::min(first + lane, between_ - 1);
    Four at{}, normal{};
    for (int k = each * (samples_ + s); k < each * (samples_ + s + 1); ++k) {
      const float* sample = rows_ + kSkinRow * sample_of_[detail_nodes_.nodes[k]];
      at += detail_nodes_.weights[k] * load_four(sample);
      normal += detail_nodes_.weights[k] * load_four(sample + 3);
    }
    at += heights_[s] * normal;
    for (int c = 0; c < 3; ++c) {
      between_rows_[kSkinRow * lane + c] = at[c];
      between_rows_[kSkinRow * lane + 3 + c] = normal[c];
    }
  }
}

Vector3 Contact::turned_back(int detail_node, Vector3 by) const noexcept {
  Four rows[3] = {};
  const int each = garment_nodes_.each, first = each * sample_of_[detail_node];
  for (int at = first; at < first + each; ++at) {
    const float* matrix = matrices_ + 12 * garment_nodes_.nodes[at];
    for (int r = 0; r < 3; ++r) {
      rows[r] += garment_nodes_.weights[at] * load_four(matrix + 4 * r);
    }
  }
  const auto row = [&](int r) { return Vector3{rows[r][0], rows[r][1], rows[r][2]}; };
  const Vector3 yz = cross(row(1), row(2)), zx = cross(row(2), row(0)), xy = cross(row(0), row(1));
  const float inverse = 1 / std::max(dot(row(0), yz), kFlattened);
  return inverse * (by.x * yz + by.y * zx + by.z * xy);
}

}  // namespace physkin

#include "evaluator/skin_guard.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "evaluator/affine.hpp"

namespace physkin {
namespace {

// [m] Cloth is moved by what it lacks, from this much before it must, so that it begins without a kink.
constexpr float kSoft = 0.002f;
// [m] Cloth this deep is of another part of the body, or has no way out to prefer; over how much it fades towards that.
constexpr float kTooDeep = 0.15f, kFade = 0.05f;
// [m] Samples this much farther off than they must be may lack something when others are moved, or a bone turns.
constexpr float kAside = 0.01f;
// Garment nodes whose samples lack less than this [m] together stay.
constexpr float kLeast = 1e-9f;
// [m] Sway that costs a sample less than this is not worth taking away for what it lacks.
constexpr float kWorthwhile = 0.002f;
// A garment node that carries this much of a sample sways as little as the sample needs.
constexpr float kCarries = 0.1f;
// [m] A sample that a shin has passed by less is led back over it, all the way where the normal is so much against it.
constexpr float kReach = 0.05f, kAgainst = 0.5f;
// What a sample lacks is its garment nodes' part only: the second time sees what the first has left.
constexpr int kPasses = 2;

// Along a part's axis: where its bones begin, and where the last one ends.
float height_of(const TrunkField& field, int bone) {
  return bone == 0 ? field.low : bone == field.bones ? field.high : field.heights[bone];
}

// [m] The largest radius between two heights, by the splines that reach there, in some directions.
float widest(const TrunkField& field, float from, float to) {
  constexpr int kDirections = 32;
  const float scale = float(field.splines - 2) / (field.high - field.low), most_cells = float(field.splines - 2);
  const auto cell = [&](float height) { return int(std::clamp((height - field.low) * scale, 0.0f, most_cells)); };
  const int first = cell(from), last = std::max(first, std::min(cell(to) + 2, field.splines - 1));
  float most = 0;
  for (int spline = first; spline <= last; ++spline) {
    const float* waves = field.coefficients + kTrunkWaves * spline;
    for (int k = 0; k < kDirections; ++k) {
      float radius = waves[0];
      for (int h = 1; 2 * h < kTrunkWaves; ++h) {
        const float angle = 6.2831853f * float(h * k) / kDirections;
        radius += waves[2 * h - 1] * std::cos(angle) + waves[2 * h] * std::sin(angle);
      }
      most = std::max(most, radius);
    }
  }
  return most;
}

// To whole calls of the kernel.
int padded(int count) { return (count + kTrunkPoints - 1) / kTrunkPoints * kTrunkPoints; }

SkinningData samples_of(const BoundGarment& g) {
  SkinningData data;
  data.nodes = g.nodes;
  data.vertex_count = g.guard_samples;
  data.influences = g.guard_influences;
  data.node_rest = g.node_rest;
  data.vertices = g.guard_vertices;
  data.normals = g.guard_vertices;  // nobody asks for them
  data.influence_nodes = g.guard_influence_nodes;
  data.influence_weights = g.guard_influence_weights;
  data.detail_vertices = g.guard_detail_influences > 0 ? g.guard_samples : 0;
  data.detail_influences = g.guard_detail_influences;
  data.detail_numbers = g.detail_numbers;
  data.detail_nodes = g.guard_detail_nodes;
  data.detail_weights = g.guard_detail_weights;
  return data;
}

// Of kTrunkPoints values, by their signs: in vector registers.
bool none_below_zero(const float* values) {
  std::int32_t bits[kTrunkPoints], signs = 0;
  std::memcpy(bits, values, sizeof bits);
  for (const std::int32_t each : bits) signs |= each;
  return signs >= 0;
}

// Views of each block by itself.
std::vector<SkinningBlocks> one_by_one(const SkinningBlocks& all) {
  std::vector<SkinningBlocks> blocks;
  for (int block = 0; block < all.block_count; ++block) {
    SkinningBlocks& one = blocks.emplace_back(all);
    one.vertex_count = std::min(all.vertex_count - block * kBlock, kBlock);
    one.block_count = 1;
    one.influence_start += block;
    one.rest += std::ptrdiff_t(block) * 6 * kBlock;
    one.vertex += std::ptrdiff_t(block) * kBlock;
    if (one.detail_start != nullptr) one.detail_start += block;
  }
  return blocks;
}

}  // namespace

SkinGuard::SkinGuard(const BoundGarment& g, const Kernels& kernels, Arena& arena)
    : kernels_(kernels),
      nodes_(g.nodes),
      samples_(g.guard_samples),
      rows_(padded(samples_)),
      influences_(g.guard_influences),
      detail_influences_(g.guard_detail_influences),
      blocks_(one_by_one(pack_skinning_blocks(samples_of(g), arena))),
      is_near_(arena.take<bool>(blocks_.size())),
      block_of_(arena.take<std::int32_t>(samples_)),
      node_rest_(arena.copy(g.node_rest, 3 * std::size_t(nodes_))),
      matrices_(arena.take<float>(12 * std::size_t(nodes_))),
      rest_(arena.copy(g.guard_vertices, 3 * std::size_t(samples_))),
      influence_nodes_(arena.copy(g.guard_influence_nodes, std::size_t(samples_) * influences_)),
      influence_weights_(arena.copy(g.guard_influence_weights, std::size_t(samples_) * influences_)),
      detail_nodes_(arena.copy(g.guard_detail_nodes, std::size_t(samples_) * detail_influences_)),
      detail_weights_(arena.copy(g.guard_detail_weights, std::size_t(samples_) * detail_influences_)),
      shares_(arena.copy(g.guard_shares, samples_)),
      skinned_(arena.take<float>(3 * std::size_t(samples_))),
      positions_(arena.take<float>(3 * std::size_t(rows_))),
      beyond_(arena.take<float>(rows_)),
      points_(arena.take<float>(3 * std::size_t(rows_))),
      contacts_(arena.take<float>(4 * std::size_t(rows_))),
      lacks_(arena.take<Lack>(std::size_t(g.skin_parts) * samples_)),
      sway_(arena.take<float>(12 * std::size_t(nodes_))),
      stilled_(arena.take<float>(nodes_)),
      sums_(arena.take<float>(4 * std::size_t(nodes_))) {
  for (std::size_t block = 0; block < blocks_.size(); ++block) {
    for (int lane = 0; lane < blocks_[block].vertex_count; ++lane) block_of_[blocks_[block].vertex[lane]] = int(block);
  }
  const std::size_t coefficients = std::size_t(g.skin_splines) * kTrunkWaves;
  for (int k = 0; k < g.skin_parts; ++k) {
    const float* shape = g.skin_shapes + 5 * k;
    Part part;
    part.bones = arena.copy(g.skin_bones + kSkinBones * k, kSkinBones);
    part.frame = arena.copy(g.skin_frames + 12 * k, 12);
    part.back = arena.take<float>(12 * kSkinBones);
    const float* heights = arena.copy(g.skin_heights + kSkinBones * k, kSkinBones);
    const float* waves = arena.copy(g.skin_coefficients + coefficients * k, coefficients);
    part.field = {1, g.skin_splines, shape[0], shape[1], shape[2], shape[3], shape[4], part.back, heights, waves};
    const float* ways = g.guard_ways + std::size_t(k) * 2 * samples_;
    const bool leads = std::any_of(ways, ways + 2 * samples_, [](float way) { return way != 0; });
    part.ways = leads ? arena.copy(ways, 2 * std::size_t(samples_)) : nullptr;
    part.reach = leads ? kReach : kAside;
    while (part.field.bones < kSkinBones && heights[part.field.bones] < kNoHeight) ++part.field.bones;
    for (int bone = 0; bone < part.field.bones; ++bone) {
      part.widths[bone] = widest(part.field, height_of(part.field, bone), height_of(part.field, bone + 1)) + part.reach;
    }
    part.gaps = arena.copy(g.guard_gaps + std::size_t(k) * samples_, samples_);
    part.near = arena.take<std::int32_t>(rows_ + 1);
    parts_.push_back(part);
  }
}

void SkinGuard::keep_out(const GarmentNodes& nodes, const float* bone_transforms, const Cloth& cloth,
                         float* node_transforms) noexcept {
  offsets_ = cloth.detail_offsets;
  for (Part& part : parts_) pose(part, bone_transforms);
  leads_far_ = true;
  for (int pass = 0; pass < kPasses; ++pass) {
    place_samples(node_transforms, leads_far_);
    if (leads_far_) {
      for (Part& part : parts_) find_near(part);
    }
    leads_far_ = false;
    if (!find_lacks()) return;
    if (pass == 0 && cloth.corrections != cloth.still) {
      sway_less(nodes, bone_transforms, cloth, node_transforms);
    }
    move_nodes(node_transforms);
  }
}

void SkinGuard::place_samples(const float* node_transforms, bool all) noexcept {
  std::fill_n(is_near_, blocks_.size(), all);
  if (!all) {
    for (const Part& part : parts_) {
      for (int k = 0; k < part.near_count; ++k) is_near_[block_of_[part.near[k]]] = true;
    }
  }
  skinning_matrices(node_transforms, node_rest_, nodes_, matrices_);
  for (std::size_t block = 0; block < blocks_.size(); ++block) {
    if (!is_near_[block]) continue;
    const SkinningBlocks& one = blocks_[block];
    kernels_.skin(one, matrices_, offsets_, {reinterpret_cast<unsigned char*>(skinned_), 3, false});
    for (int lane = 0; lane < one.vertex_count; ++lane) {
      const std::ptrdiff_t s = one.vertex[lane];
      for (int axis = 0; axis < 3; ++axis) positions_[axis * rows_ + s] = skinned_[3 * s + axis];
    }
  }
}

void SkinGuard::pose(Part& part, const float* bone_transforms) const noexcept {
  const Affine frame = load_affine(part.frame);
  for (int k = 0; k < part.field.bones; ++k) {
    const Affine bone = load_affine(bone_transforms + 12 * part.bones[k]);
    const Matrix3 back = frame.linear * from_columns(bone.linear.rows[0], bone.linear.rows[1], bone.linear.rows[2]);
    store_affine({back, frame.translation - back * bone.translation}, part.back + 12 * k);
  }
  for (int k = 0; k <= part.field.bones; ++k) {
    const Affine back = load_affine(part.back + 12 * std::min(k, part.field.bones - 1));
    const Vector3 from = Vector3{part.field.x, part.field.y, height_of(part.field, k)} - back.translation;
    const Vector3 at = from.x * back.linear.rows[0] + from.y * back.linear.rows[1] + from.z * back.linear.rows[2];
    const float posed[] = {at.x, at.y, at.z};
    std::copy_n(posed, 3, part.axis + 3 * k);
  }
}

void SkinGuard::find_near(Part& part) noexcept {
  kernels_.axis_beyond(part.axis, part.widths, part.field.bones, positions_, rows_, beyond_);
  part.near_count = 0;
  for (int first = 0; first < samples_; first += kTrunkPoints) {
    if (none_below_zero(beyond_ + first)) continue;
    for (int s = first; s < std::min(first + kTrunkPoints, samples_); ++s) {
      part.near[part.near_count] = s;
      part.near_count += beyond_[s] < 0;
    }
  }
}

bool SkinGuard::find_lacks() noexcept {
  lack_count_ = 0;
  for (Part& part : parts_) add_lacks(part);
  return lack_count_ > 0;
}

void SkinGuard::add_lacks(Part& part) noexcept {
  const int count = part.near_count, rows = padded(count);
  if (count == 0) return;
  std::fill_n(part.near + count, rows - count, part.near[count - 1]);
  for (int axis = 0; axis < 3; ++axis) {
    const float* from = positions_ + axis * rows_;
    for (int k = 0; k < rows; ++k) points_[axis * rows + k] = from[part.near[k]];
  }
  kernels_.trunk_depth(part.field, points_, rows, contacts_);
  part.near_count = 0;
  for (int k = 0; k < count; ++k) {
    const int s = part.near[k];
    const float depth = contacts_[k], wanted = depth + part.gaps[s] + kSoft;
    part.near[part.near_count] = s;
    part.near_count += wanted > -part.reach;
    const bool may_lead = part.ways != nullptr && depth > -kReach;
    if (!(wanted > 0 || may_lead) || !(depth < kTooDeep)) continue;
    const Vector3 normal{contacts_[rows + k], contacts_[2 * rows + k], contacts_[3 * rows + k]};
    const float soft = std::max(wanted < 2 * kSoft ? wanted * wanted / (4 * kSoft) : wanted - kSoft, 0.0f);
    Lack lack{s, wanted > 0 ? soft : 0, normalized(normal), 0};
    if (may_lead) lead_back(part, s, depth, lack);
    if (!(lack.length > 0)) continue;
    lack.length *= shares_[s] * std::min((kTooDeep - depth) / kFade, 1.0f);
    lacks_[lack_count_++] = lack;
  }
}

void SkinGuard::lead_back(const Part& part, int sample, float depth, Lack& lack) noexcept {
  const Affine back = load_affine(part.back);
  const float* way = part.ways + 2 * sample;
  const Vector3 out = way[0] * back.linear.rows[0] + way[1] * back.linear.rows[1];
  const float against = std::min(-dot(lack.normal, out) / kAgainst, 1.0f);
  if (!(against > 0)) return;
  leads_far_ = true;
  const float turned = against * against * (3 - 2 * against);
  const Vector3 at = back.linear * load_vector(skinned_ + 3 * sample) + back.translation;
  const float x = at.x - part.field.x, y = at.y - part.field.y;
  const Vector3 towards = normalized((1 - turned) * lack.normal + turned * out);
  const float tx = dot(towards, back.linear.rows[0]), ty = dot(towards, back.linear.rows[1]);
  const float flat = std::sqrt(tx * tx + ty * ty + 1e-6f), along = (x * tx + y * ty) / flat;
  const float radius = std::sqrt(x * x + y * y) + depth + std::max(part.gaps[sample], 0.0f);
  const float over = (std::sqrt(std::max(radius * radius - x * x - y * y + along * along, 0.0f)) - along) / flat;
  const float faded = std::min((depth + kReach) / kReach, 1.0f);
  lack.length += turned * (faded * over - lack.length);
  lack.normal = towards;
}

// What samples lack afterwards is foreseen: looking it up would take as long as all of this.
void SkinGuard::sway_less(const GarmentNodes& nodes, const float* bone_transforms, const Cloth& cloth,
                          float* node_transforms) noexcept {
  std::fill_n(stilled_, nodes_, -1.0f);
  for (int at = 0; at < lack_count_; ++at) {
    Lack& lack = lacks_[at];
    const std::size_t first = std::size_t(lack.sample) * influences_;
    for (int k = 0; k < influences_; ++k) {
      const int node = influence_nodes_[first + k];
      if (stilled_[node] >= 0) continue;
      stilled_[node] = 0;
      store_affine(nodes.added(node, bone_transforms, cloth.corrections, cloth.still), sway_ + 12 * node);
    }
    lack.cost = std::max(-dot(lack.normal, swayed(lack.sample)), 0.0f);
    const float needed = std::min(lack.length * lack.cost / (lack.cost * lack.cost + kWorthwhile * kWorthwhile), 1.0f);
    for (int k = 0; k < influences_; ++k) {
      float& stilled = stilled_[influence_nodes_[first + k]];
      stilled = std::max(stilled, needed * std::min(influence_weights_[first + k] / kCarries, 1.0f));
    }
  }
  for (int i = 0; i < nodes_; ++i) {
    if (!(stilled_[i] > 0)) continue;
    for (int k = 0; k < 12; ++k) node_transforms[12 * i + k] -= stilled_[i] * sway_[12 * i + k];
  }
  for (int at = 0; at < lack_count_; ++at) {
    Lack& lack = lacks_[at];
    const std::size_t first = std::size_t(lack.sample) * influences_;
    float share = 0;
    for (int k = 0; k < influences_; ++k)
      share += influence_weights_[first + k] * stilled_[influence_nodes_[first + k]];
    lack.length = std::max(lack.length - share * lack.cost, 0.0f);
  }
}

Vector3 SkinGuard::swayed(int sample) const noexcept {
  Vector3 rest = load_vector(rest_ + 3 * sample);
  for (int k = detail_influences_ * sample; k < detail_influences_ * (sample + 1); ++k) {
    rest = rest + detail_weights_[k] * load_vector(offsets_ + 3 * std::ptrdiff_t(detail_nodes_[k]));
  }
  Vector3 moved{0, 0, 0};
  for (int k = influences_ * sample; k < influences_ * (sample + 1); ++k) {
    const int node = influence_nodes_[k];
    const Affine sway = load_affine(sway_ + 12 * node);
    const Vector3 by = sway.linear * (rest - load_vector(node_rest_ + 3 * node)) + sway.translation;
    moved = moved + influence_weights_[k] * by;
  }
  return moved;
}

// What lacks more counts more, so that a sample that hardly lacks anything does not hold back one beside it.
void SkinGuard::move_nodes(float* node_transforms) noexcept {
  std::fill_n(sums_, 4 * std::size_t(nodes_), 0.0f);
  for (int at = 0; at < lack_count_; ++at) {
    const Lack& lack = lacks_[at];
    const std::size_t first = std::size_t(lack.sample) * influences_;
    for (int k = 0; k < influences_; ++k) {
      const float share = influence_weights_[first + k] * lack.length, counted = share * lack.length;
      float* to = sums_ + 4 * influence_nodes_[first + k];
      to[0] += counted * lack.normal.x;
      to[1] += counted * lack.normal.y;
      to[2] += counted * lack.normal.z;
      to[3] += share;
    }
  }
  for (int i = 0; i < nodes_; ++i) {
    const float* sum = sums_ + 4 * i;
    if (!(sum[3] > kLeast)) continue;
    for (int axis = 0; axis < 3; ++axis) node_transforms[12 * i + 4 * axis + 3] += sum[axis] / sum[3];
  }
}

}  // namespace physkin

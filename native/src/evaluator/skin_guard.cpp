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
// [m] Sway that costs a sample less than this is not worth taking away for what it lacks.
constexpr float kWorthwhile = 0.002f;
// A garment node that carries this much of a sample sways as little as the sample needs: where it would lack something,
// and where sway leads it through a leg. Less is enough there, as what is left lacks something then.
constexpr float kCarries = 0.2f, kCarriesThrough = 0.3f;
// [m] A sample that a shin has passed by less is led back over it, all the way where the normal is so much against it.
constexpr float kReach = 0.05f, kAgainst = 0.5f;
// What a sample lacks is its garment nodes' part only: the second time sees what the first has left.
constexpr int kPasses = 2;

// Of kTrunkPoints values, by their signs: in vector registers.
bool none_below_zero(const float* values) {
  std::int32_t bits[kTrunkPoints], signs = 0;
  std::memcpy(bits, values, sizeof bits);
  for (const std::int32_t each : bits) signs |= each;
  return signs >= 0;
}

// (nodes, blocks) which garment nodes carry a sample of which block.
const bool* carried_blocks(const ClothSamples& cloth, const std::int32_t* influence_nodes, int influences, int nodes,
                           Arena& arena) {
  bool* carries = arena.take<bool>(std::size_t(nodes) * std::size_t(cloth.blocks()));
  for (int at = 0; at < cloth.count() * influences; ++at) {
    carries[influence_nodes[at] * cloth.blocks() + at / influences / kBlock] = true;
  }
  return carries;
}

}  // namespace

SkinGuard::SkinGuard(const BoundGarment& g, const std::vector<SkinPart>& skin, const Kernels& kernels, Arena& arena)
    : kernels_(kernels),
      nodes_(g.nodes),
      cloth_(g, g.guard, kernels, arena),
      samples_(cloth_.count()),
      rows_(cloth_.rows()),
      influences_(g.guard.influences),
      is_near_(arena.take<bool>(cloth_.blocks())),
      is_carried_(arena.take<bool>(cloth_.blocks())),
      has_changed_(arena.take<bool>(nodes_)),
      node_rest_(arena.copy(g.node_rest, 3 * std::size_t(nodes_))),
      matrices_(arena.take<float>(12 * std::size_t(nodes_))),
      positions_(arena.take<float>(3 * std::size_t(rows_))),
      unswayed_matrices_(arena.take<float>(12 * std::size_t(nodes_))),
      unswayed_positions_(arena.take<float>(3 * std::size_t(rows_))),
      influence_nodes_(cloth_.in_order(g.guard.influence_nodes, influences_, arena)),
      influence_weights_(cloth_.in_order(g.guard.influence_weights, influences_, arena)),
      carries_(carried_blocks(cloth_, influence_nodes_, influences_, nodes_, arena)),
      shares_(cloth_.in_order(g.guard_shares, 1, arena)),
      beyond_(arena.take<float>(rows_)),
      points_(arena.take<float>(3 * std::size_t(rows_))),
      contacts_(arena.take<float>(4 * std::size_t(rows_))),
      crossed_(arena.take<float>(std::size_t(rows_))),
      unswayed_(arena.take<float>(12 * std::size_t(nodes_))),
      lacks_(arena.take<Lack>(std::size_t(g.skin_parts) * samples_)),
      sway_(arena.take<float>(12 * std::size_t(nodes_))),
      stilled_(arena.take<float>(nodes_)),
      moved_(arena.take<float>(nodes_)),
      sums_(arena.take<float>(4 * std::size_t(nodes_))) {
  for (std::size_t k = 0; k < skin.size(); ++k) {
    if (skin[k].presses) continue;
    const float* ways = g.guard_ways + k * 2 * samples_;
    const bool leads = std::any_of(ways, ways + 2 * samples_, [](float way) { return way != 0; });
    Part part{skin[k],
              {},
              cloth_.in_order(g.guard_gaps + k * samples_, 1, arena),
              nullptr,
              leads ? kReach : kAside,
              arena.take<std::int32_t>(rows_ + 1),
              0};
    if (leads) part.ways = cloth_.in_order(ways, 2, arena);
    for (int bone = 0; bone < kSkinBones; ++bone) part.widths[bone] = skin[k].widths[bone] + part.reach;
    parts_.push_back(part);
  }
}

void SkinGuard::keep_out(const GarmentNodes& nodes, const float* bone_transforms, const Cloth& cloth,
                         float* node_transforms) noexcept {
  leads_far_ = true;
  const bool sways = cloth.corrections != cloth.still;
  cloth_.begin(cloth.detail_offsets);
  place_samples(node_transforms);
  if (sways && hold_back(nodes, bone_transforms, cloth, node_transforms)) place_changed(node_transforms, true);
  for (int pass = 0; pass < kPasses; ++pass) {
    if (pass > 0) place_changed(node_transforms, leads_far_);
    if (leads_far_) {
      for (Part& part : parts_) find_near(part);
    }
    leads_far_ = false;
    any_moved_ = find_lacks();
    if (!any_moved_) return;
    if (pass == 0 && sways) sway_less(node_transforms);
    move_nodes(node_transforms);
  }
}

void SkinGuard::place_samples(const float* node_transforms) noexcept {
  std::fill_n(has_changed_, nodes_, false);
  skinning_matrices(node_transforms, node_rest_, nodes_, matrices_);
  for (int block = 0; block < cloth_.blocks(); ++block) cloth_.place(block, matrices_, positions_);
}

void SkinGuard::place_changed(const float* node_transforms, bool all) noexcept {
  std::fill_n(is_near_, cloth_.blocks(), all);
  if (!all) {
    for (const Part& part : parts_) {
      for (int k = 0; k < part.near_count; ++k) is_near_[part.near[k] / kBlock] = true;
    }
  }
  std::fill_n(is_carried_, cloth_.blocks(), false);
  for (int i = 0; i < nodes_; ++i) {
    if (!has_changed_[i]) continue;
    has_changed_[i] = false;
    skinning_matrices(node_transforms + 12 * i, node_rest_ + 3 * i, 1, matrices_ + 12 * i);
    const bool* carries = carries_ + std::ptrdiff_t(i) * cloth_.blocks();
    for (int block = 0; block < cloth_.blocks(); ++block) is_carried_[block] |= carries[block];
  }
  for (int block = 0; block < cloth_.blocks(); ++block) {
    if (is_near_[block] && is_carried_[block]) cloth_.place(block, matrices_, positions_);
  }
}

void SkinGuard::find_near(Part& part) noexcept {
  kernels_.axis_beyond(part.skin.axis, part.widths, part.skin.field.bones, positions_, rows_, beyond_);
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
  const int count = part.near_count, rows = padded_to_points(count);
  if (count == 0) return;
  std::fill_n(part.near + count, rows - count, part.near[count - 1]);
  for (int axis = 0; axis < 3; ++axis) {
    const float* from = positions_ + axis * rows_;
    for (int k = 0; k < rows; ++k) points_[axis * rows + k] = from[part.near[k]];
  }
  kernels_.trunk_depth(part.skin.field, points_, rows, contacts_);
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
  const Affine back = load_affine(part.skin.back);
  const float* way = part.ways + 2 * sample;
  const Vector3 out = way[0] * back.linear.rows[0] + way[1] * back.linear.rows[1];
  const float against = std::min(-dot(lack.normal, out) / kAgainst, 1.0f);
  if (!(against > 0)) return;
  leads_far_ = true;
  const float turned = against * against * (3 - 2 * against);
  const Vector3 seen = back.linear * at(sample) + back.translation;
  const float x = seen.x - part.skin.field.x, y = seen.y - part.skin.field.y;
  const Vector3 towards = normalized((1 - turned) * lack.normal + turned * out);
  const float tx = dot(towards, back.linear.rows[0]), ty = dot(towards, back.linear.rows[1]);
  const float flat = std::sqrt(tx * tx + ty * ty + 1e-6f), along = (x * tx + y * ty) / flat;
  const float radius = std::sqrt(x * x + y * y) + depth + std::max(part.gaps[sample], 0.0f);
  const float over = (std::sqrt(std::max(radius * radius - x * x - y * y + along * along, 0.0f)) - along) / flat;
  const float faded = std::min((depth + kReach) / kReach, 1.0f);
  lack.length += turned * (faded * over - lack.length);
  lack.normal = towards;
}

bool SkinGuard::hold_back(const GarmentNodes& nodes, const float* bone_transforms, const Cloth& cloth,
                          float* node_transforms) noexcept {
  for (int i = 0; i < nodes_; ++i) {
    store_affine(nodes.added(i, bone_transforms, cloth.corrections, cloth.still), sway_ + 12 * i);
  }
  for (int k = 0; k < 12 * nodes_; ++k) unswayed_[k] = node_transforms[k] - sway_[k];
  skinning_matrices(unswayed_, node_rest_, nodes_, unswayed_matrices_);
  for (int block = 0; block < cloth_.blocks(); ++block) cloth_.place(block, unswayed_matrices_, unswayed_positions_);
  std::fill_n(crossed_, rows_, 0.0f);
  for (const Part& part : parts_) {
    kernels_.axis_crossed(part.skin.axis, part.skin.widths, part.skin.field.bones, unswayed_positions_, positions_,
                          rows_, crossed_);
  }
  std::fill_n(stilled_, nodes_, 0.0f);
  bool crosses = false;
  for (int s = 0; s < samples_; ++s) {
    if (!(crossed_[s] > 0)) continue;
    still(s, shares_[s] * crossed_[s], kCarriesThrough);
    crosses = true;
  }
  if (!crosses) return false;
  take_away(node_transforms);
  for (int i = 0; i < nodes_; ++i) {
    for (int k = 0; k < 12; ++k) sway_[12 * i + k] *= 1 - stilled_[i];
  }
  return true;
}

void SkinGuard::still(int sample, float share, float carries) noexcept {
  for (int k = influences_ * sample; k < influences_ * (sample + 1); ++k) {
    float& stilled = stilled_[influence_nodes_[k]];
    stilled = std::max(stilled, share * std::min(influence_weights_[k] / carries, 1.0f));
  }
}

void SkinGuard::take_away(float* node_transforms) noexcept {
  for (int i = 0; i < nodes_; ++i) {
    if (!(stilled_[i] > 0)) continue;
    has_changed_[i] = true;
    for (int k = 0; k < 12; ++k) node_transforms[12 * i + k] -= stilled_[i] * sway_[12 * i + k];
  }
}

// What samples lack afterwards is foreseen: looking it up would take as long as all of this.
void SkinGuard::sway_less(float* node_transforms) noexcept {
  std::fill_n(stilled_, nodes_, 0.0f);
  for (int at = 0; at < lack_count_; ++at) {
    Lack& lack = lacks_[at];
    lack.cost = std::max(-dot(lack.normal, swayed(lack.sample)), 0.0f);
    const float needed = lack.length * lack.cost / (lack.cost * lack.cost + kWorthwhile * kWorthwhile);
    still(lack.sample, std::min(needed, 1.0f), kCarries);
  }
  take_away(node_transforms);
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
  const Vector3 rest = cloth_.at_rest(sample);
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
    moved_[i] = 0;
    if (!(sum[3] > kLeast)) continue;
    const Vector3 by = (1 / sum[3]) * load_vector(sum);
    moved_[i] = std::sqrt(dot(by, by));
    has_changed_[i] = true;
    node_transforms[12 * i + 3] += by.x;
    node_transforms[12 * i + 7] += by.y;
    node_transforms[12 * i + 11] += by.z;
  }
}

}  // namespace physkin

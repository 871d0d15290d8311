#include "evaluator/cloth_dents.hpp"

#include <algorithm>
#include <cmath>

namespace physkin {
namespace {

// [m] Cloth is moved by what it lacks, from this much before it must, so that it begins without a kink.
constexpr float kSoft = 0.002f;
// [m] Cloth is kept so far from the skin.
constexpr float kGap = 0.003f;
// [m] Cloth that an arm has passed by more stays where it is; what it has passed by less than kFull gives way all the way.
constexpr float kReach = 0.08f, kFull = 0.04f;
// [m] Cloth beside an arm that presses goes along, less and less, over this.
constexpr float kAside = 0.06f;
// [m] Where garment nodes have moved by no more in the last pass nothing is left to push, and by twice as much all is.
constexpr float kMoved = 0.001f;
// [m] Farther from its axis than the rest of the body is wide, and this, nothing is pushed.
constexpr float kOff = 0.01f;
// [m] By an arm cloth is kept so far from the rest of the body, whose skin stands out of its smooth surface.
constexpr float kLeft = 0.01f;
// [m] How cloth is led over an arm begins at its edge without a step, over this.
constexpr float kEdge = 0.005f;
// An arm that points at the body moves cloth by what crosses it, divided by no less than this.
constexpr float kFlattest = 0.5f;
// [m] Of parts of the body that are this much farther off than one that is touched, the way there counts a sixteenth.
constexpr float kBlur = 0.02f;
// [m] The body is looked for up to here from arms.
constexpr float kFar = 0.3f;
// [m] By how much detail may move samples from where their garment node has them.
constexpr float kDetail = 0.04f;
// Places along an arm's axis from which the way to the body is looked up.
constexpr int kStations = 4;
// Beside skin that is narrower than detail nodes are apart, cloth is moved by more than it lacks.
constexpr float kAhead = 1.4f;
// [m] Cloth this deep is of another part of the body, or has no way out to prefer; over how much it fades towards that.
constexpr float kTooDeep = 0.15f, kFade = 0.05f;
// Where skinning makes less of a volume than this, dents are made as if it were this.
constexpr float kFlattened = 0.3f;
// Samples that less is asked of [m] stay.
constexpr float kLeast = 1e-5f;

std::vector<std::int32_t> carriers(const ClothSampling& of) {
  std::vector<std::int32_t> found;
  for (int s = 0; s < of.samples; ++s) {
    const float* weights = of.influence_weights + std::size_t(s) * of.influences;
    const auto at = std::max_element(weights, weights + of.influences) - of.influence_weights;
    found.push_back(of.influence_nodes[at]);
  }
  return found;
}

}  // namespace

ClothDents::ClothDents(const BoundGarment& g, const std::vector<SkinPart>& skin, const Kernels& kernels, Arena& arena)
    : kernels_(kernels),
      nodes_(g.nodes),
      detail_numbers_(g.detail_numbers),
      cloth_(g, g.dent, kernels, arena),
      rows_(cloth_.rows()),
      middle_rows_(padded_to_points(cloth_.blocks())),
      node_rest_(arena.copy(g.node_rest, 3 * std::size_t(nodes_))),
      matrices_(arena.take<float>(12 * std::size_t(nodes_))),
      positions_(arena.take<float>(3 * std::size_t(rows_))),
      is_near_(arena.take<bool>(std::size_t(cloth_.blocks()))),
      carriers_each_(g.dent.influences),
      carrying_nodes_(cloth_.in_order(g.dent.influence_nodes, carriers_each_, arena)),
      carrying_weights_(cloth_.in_order(g.dent.influence_weights, carriers_each_, arena)),
      carrier_(cloth_.in_order(carriers(g.dent).data(), 1, arena)),
      detail_influences_(g.dent.detail_influences),
      influence_nodes_(cloth_.in_order(g.dent.detail_nodes, detail_influences_, arena)),
      influence_weights_(cloth_.in_order(g.dent.detail_weights, detail_influences_, arena)),
      detail_nodes_(cloth_.in_order(g.dent_nodes, 1, arena)),
      shares_(cloth_.in_order(g.dent_shares, 1, arena)),
      middle_carrier_(arena.take<std::int32_t>(std::size_t(cloth_.blocks()))),
      middle_rest_(arena.take<float>(3 * std::size_t(cloth_.blocks()))),
      middles_(arena.take<float>(3 * std::size_t(middle_rows_))),
      radius_(arena.take<float>(std::size_t(cloth_.blocks()))),
      is_moved_(arena.take<bool>(std::size_t(cloth_.blocks()))),
      beyond_(arena.take<float>(std::size_t(std::max(middle_rows_, rows_)))) {
  const float* vertices = cloth_.in_order(g.dent.vertices, 3, arena);
  for (int block = 0; block < cloth_.blocks(); ++block) {
    Vector3 middle{0, 0, 0};
    const int begin = kBlock * block, end = cloth_.end(block);
    const auto at = [&](int sample) { return load_vector(vertices + 3 * sample); };
    for (int s = begin; s < end; ++s) middle = middle + (1.0f / float(end - begin)) * at(s);
    int nearest = begin;
    for (int s = begin; s < end; ++s) {
      const Vector3 away = at(s) - middle, least = at(nearest) - middle;
      if (dot(away, away) < dot(least, least)) nearest = s;
      radius_[block] = std::max(radius_[block], std::sqrt(dot(away, away)) + kDetail);
    }
    middle_carrier_[block] = carrier_[nearest];
    const float rest[] = {middle.x, middle.y, middle.z};
    std::copy_n(rest, 3, middle_rest_ + 3 * block);
  }
  for (const SkinPart& skin_part : skin) {
    Part part{skin_part, {}, 0, arena.take<bool>(std::size_t(cloth_.blocks())), false, {}};
    for (int bone = 0; bone < skin_part.field.bones; ++bone) {
      part.widths[bone] = skin_part.widths[bone] + (skin_part.presses ? kReach : kOff);
      part.widest = std::max(part.widest, part.widths[bone]);
    }
    (skin_part.presses ? arms_ : body_).push_back(part);
  }
  const std::size_t rows = std::size_t(std::max(rows_, padded_to_points(kStations * int(arms_.size()))));
  points_ = arena.take<float>(3 * rows);
  contacts_ = arena.take<float>(4 * rows);
  ways_ = arena.take<float>(3 * rows);
  room_ = arena.take<float>(rows);
  sums_ = arena.take<float>(4 * std::size_t(cloth_.count()));
  chosen_ = arena.take<std::int32_t>(rows);
  is_asked_ = arena.take<bool>(std::size_t(cloth_.count()));
  asked_ = arena.take<std::int32_t>(std::size_t(cloth_.count()));
  moves_ = arena.take<float>(std::size_t(detail_numbers_));
  dented_ = arena.take<float>(std::size_t(detail_numbers_));
}

const float* ClothDents::dent(const SkinGuard& guard, const float* node_transforms, const float* offsets) noexcept {
  place_middles(node_transforms);
  if (!find_near(guard)) return offsets;
  skinning_matrices(node_transforms, node_rest_, nodes_, matrices_);
  for (; asked_count_ > 0; --asked_count_) {
    const int s = asked_[asked_count_ - 1];
    std::fill_n(sums_ + 4 * s, 4, 0.0f);
    is_asked_[s] = false;
  }
  cloth_.begin(offsets);
  for (int block = 0; block < cloth_.blocks(); ++block) {
    if (is_near_[block]) cloth_.place(block, matrices_, positions_);
  }
  const auto any_near = [](const Part& part) { return part.any_near; };
  if (std::any_of(arms_.begin(), arms_.end(), any_near)) find_ways();
  for (const Part& arm : arms_) {
    if (arm.any_near) press(arm);
  }
  keep_room();
  for (const Part& part : body_) {
    if (part.any_near) push(part, guard);
  }
  return moved(offsets);
}

void ClothDents::place_middles(const float* node_transforms) noexcept {
  for (int block = 0; block < cloth_.blocks(); ++block) {
    const int node = middle_carrier_[block];
    const Affine carrier = load_affine(node_transforms + 12 * node);
    const Vector3 from = load_vector(middle_rest_ + 3 * block) - load_vector(node_rest_ + 3 * node);
    const Vector3 at = carrier.linear * from + carrier.translation;
    middles_[block] = at.x;
    middles_[middle_rows_ + block] = at.y;
    middles_[2 * middle_rows_ + block] = at.z;
  }
}

bool ClothDents::find_near(const SkinGuard& guard) noexcept {
  for (int block = 0; block < cloth_.blocks() && guard.any_moved(); ++block) {
    is_moved_[block] = false;
    for (int s = kBlock * block; s < cloth_.end(block); ++s) {
      is_moved_[block] |= guard.moved(carrier_[s]) > kMoved;
    }
  }
  std::fill_n(is_near_, cloth_.blocks(), false);
  bool any = false;
  for (auto* parts : {&body_, &arms_}) {
    for (Part& part : *parts) {
      part.any_near = false;
      if (!part.skin.presses && !guard.any_moved()) continue;
      kernels_.axis_beyond(part.skin.axis, part.widths, part.skin.field.bones, middles_, middle_rows_, beyond_);
      for (int block = 0; block < cloth_.blocks(); ++block) {
        const bool reaches = beyond_[block] < radius_[block] * (radius_[block] + 2 * part.widest);
        part.near[block] = reaches && (part.skin.presses || is_moved_[block]);
        part.any_near |= part.near[block];
        is_near_[block] |= part.near[block];
      }
      any |= part.any_near;
    }
  }
  return any;
}

void ClothDents::find_ways() noexcept {
  const int count = kStations * int(arms_.size()), rows = padded_to_points(count);
  for (int at = 0; at < rows; ++at) {
    const SkinPart& arm = arms_[std::size_t(std::min(at, count - 1) / kStations)].skin;
    const float along = (float(at % kStations) + 0.5f) / kStations;
    const float* last = arm.axis + 3 * arm.field.bones;
    for (int axis = 0; axis < 3; ++axis) {
      points_[axis * rows + at] = arm.axis[axis] + along * (last[axis] - arm.axis[axis]);
    }
  }
  for (Part& part : body_) part.is_far = false;
  find_body(rows);
  for (std::size_t k = 0; k < arms_.size(); ++k) {
    Vector3 sum{0, 0, 0};
    for (int at = kStations * int(k); at < kStations * int(k + 1); ++at) {
      sum = sum + Vector3{ways_[at], ways_[rows + at], ways_[2 * rows + at]};
    }
    arms_[k].towards = normalized(sum);
  }
}

void ClothDents::find_body(int rows) noexcept {
  std::fill_n(ways_, 3 * std::size_t(rows), 0.0f);
  std::fill_n(room_, rows, kFar);
  for (Part& part : body_) {
    if (part.is_far) continue;
    kernels_.trunk_depth(part.skin.field, points_, rows, contacts_);
    float least = 2 * kFar;
    for (int k = 0; k < rows; ++k) {
      const float off = -contacts_[k], near = kBlur / (std::max(off, 0.0f) + kBlur), counts = near * near * near * near;
      for (int axis = 0; axis < 3; ++axis) ways_[axis * rows + k] -= counts * contacts_[(axis + 1) * rows + k];
      room_[k] = std::min(room_[k], off);
      least = std::min(least, off);
    }
    part.is_far = least > kFar;
  }
  for (int k = 0; k < rows; ++k) {
    const Vector3 way = normalized({ways_[k], ways_[rows + k], ways_[2 * rows + k]});
    ways_[k] = way.x, ways_[rows + k] = way.y, ways_[2 * rows + k] = way.z;
  }
}

template <class May>
int ClothDents::look_up(const Part& part, May may) noexcept {
  int count = 0;
  for (int block = 0; block < cloth_.blocks(); ++block) {
    if (!part.near[block]) continue;
    for (int s = kBlock * block; s < cloth_.end(block); ++s) {
      chosen_[count] = s;
      count += may(s);
    }
  }
  kernels_.axis_beyond(part.skin.axis, part.widths, part.skin.field.bones, points_, gather(count), beyond_);
  int left = 0;
  for (int k = 0; k < count; ++k) {
    chosen_[left] = chosen_[k];
    left += beyond_[k] < 0;
  }
  kernels_.trunk_depth(part.skin.field, points_, gather(left), contacts_);
  return left;
}

int ClothDents::gather(int count) noexcept {
  const int rows = padded_to_points(count);
  for (int axis = 0; axis < 3; ++axis) {
    const float* from = positions_ + axis * rows_;
    for (int k = 0; k < rows; ++k) points_[axis * rows + k] = from[chosen_[std::min(k, count - 1)]];
  }
  return rows;
}

// What is asked by more than one part counts by how much it is.
void ClothDents::ask(int sample, float length, Vector3 way) noexcept {
  float* sum = sums_ + 4 * sample;
  if (!is_asked_[sample]) asked_[asked_count_++] = sample;
  is_asked_[sample] = true;
  sum[0] += length * length * way.x;
  sum[1] += length * length * way.y;
  sum[2] += length * length * way.z;
  sum[3] += length;
}

void ClothDents::push(const Part& part, const SkinGuard& guard) noexcept {
  const auto may = [&](int sample) { return guard.moved(carrier_[sample]) > kMoved; };
  const int count = look_up(part, may), rows = padded_to_points(count);
  for (int k = 0; k < count; ++k) {
    const float depth = contacts_[k], wanted = depth + kGap + kSoft;
    if (!(wanted > 0) || !(depth < kTooDeep)) continue;
    const float lack = wanted < 2 * kSoft ? wanted * wanted / (4 * kSoft) : wanted - kSoft;
    const Vector3 normal{contacts_[rows + k], contacts_[2 * rows + k], contacts_[3 * rows + k]};
    const float counts = std::min((guard.moved(carrier_[chosen_[k]]) - kMoved) / kMoved, 1.0f);
    ask(chosen_[k], counts * kAhead * lack * std::min((kTooDeep - depth) / kFade, 1.0f), normalized(normal));
  }
}

void ClothDents::press(const Part& arm) noexcept {
  const int count = look_up(arm, [](int) { return true; });
  const TrunkField& field = arm.skin.field;
  const Affine back = load_affine(arm.skin.back);
  const Vector3 way = back.linear * arm.towards;
  const float across = std::sqrt(way.x * way.x + way.y * way.y + 1e-6f), flat = std::max(across, kFlattest);
  for (int k = 0; k < count; ++k) {
    const float depth = contacts_[k];
    if (!(depth > -kReach)) continue;
    // In the arm's cross section: how far along the way out, how far aside, and how wide the arm is.
    const Vector3 seen = back.linear * at(chosen_[k]) + back.translation;
    const float x = seen.x - field.x, y = seen.y - field.y, square = x * x + y * y;
    const float along = (x * way.x + y * way.y) / across, radius = std::sqrt(square) + depth + kGap;
    if (along > std::fabs(radius)) continue;  // beyond the arm on its way
    const float aside = std::sqrt(std::max(square - along * along, 0.0f)), over = aside - radius;
    const float within = over < 0 ? radius * radius - aside * aside : 0;
    const float exit = std::sqrt(within + kEdge * kEdge) - kEdge;
    const float least = over < 0 ? 1 : std::max(1 - over / kAside, 0.0f);
    const float wanted = least * std::max(exit - along, 0.0f) / flat;
    const float faded = std::min((depth + kReach) / (kReach - kFull), 1.0f);
    const float asked = faded * (wanted < 2 * kSoft ? wanted * wanted / (4 * kSoft) : wanted - kSoft);
    if (asked > 0) ask(chosen_[k], asked, arm.towards);
  }
}

int ClothDents::choose_asked() noexcept {
  int count = 0;
  for (int k = 0; k < asked_count_; ++k) {
    chosen_[count] = asked_[k];
    count += sums_[4 * asked_[k] + 3] > kLeast;
  }
  return count;
}

void ClothDents::keep_room() noexcept {
  const int count = choose_asked(), rows = gather(count);
  if (count == 0) return;
  find_body(rows);
  for (int k = 0; k < count; ++k) {
    float* sum = sums_ + 4 * chosen_[k];
    const Vector3 asked = (1 / sum[3]) * load_vector(sum);
    const float along = asked.x * ways_[k] + asked.y * ways_[rows + k] + asked.z * ways_[2 * rows + k];
    const float room = std::max(room_[k] - kLeft, 0.0f), share = along > room ? room / along : 1;
    std::fill_n(sum, 4, 0.0f);
    const float length = std::sqrt(dot(asked, asked));
    ask(chosen_[k], share * length, normalized(asked));
  }
}

// A vertex goes with several detail nodes, half of it or so with its nearest one: what neighbours that are not asked
// hold back is added.
const float* ClothDents::moved(const float* offsets) noexcept {
  const int count = choose_asked();
  if (count == 0) return offsets;
  for (int k = 0; k < count; ++k) {
    const int s = chosen_[k];
    const Vector3 by = (shares_[s] / sums_[4 * s + 3]) * load_vector(sums_ + 4 * s);
    const float moved[] = {by.x, by.y, by.z};
    std::copy_n(moved, 3, moves_ + 3 * detail_nodes_[s]);
  }
  std::copy_n(offsets, detail_numbers_, dented_);
  for (int k = 0; k < count; ++k) {
    const int s = chosen_[k];
    Vector3 by = 2.0f * load_vector(moves_ + 3 * detail_nodes_[s]);
    for (int at = detail_influences_ * s; at < detail_influences_ * (s + 1); ++at) {
      by = by - influence_weights_[at] * load_vector(moves_ + 3 * influence_nodes_[at]);
    }
    const Vector3 at_rest = turned_back(s, by);
    const float added[] = {at_rest.x, at_rest.y, at_rest.z};
    for (int axis = 0; axis < 3; ++axis) dented_[3 * detail_nodes_[s] + axis] += added[axis];
  }
  for (int k = 0; k < count; ++k) std::fill_n(moves_ + 3 * detail_nodes_[chosen_[k]], 3, 0.0f);
  return dented_;
}

Vector3 ClothDents::turned_back(int sample, Vector3 by) const noexcept {
  Vector3 x{0, 0, 0}, y{0, 0, 0}, z{0, 0, 0};  // columns of the linear part that skinning has there
  for (int at = carriers_each_ * sample; at < carriers_each_ * (sample + 1); ++at) {
    const Affine node = load_affine(matrices_ + 12 * carrying_nodes_[at]);
    const float weight = carrying_weights_[at];
    x = x + weight * Vector3{node.linear.rows[0].x, node.linear.rows[1].x, node.linear.rows[2].x};
    y = y + weight * Vector3{node.linear.rows[0].y, node.linear.rows[1].y, node.linear.rows[2].y};
    z = z + weight * Vector3{node.linear.rows[0].z, node.linear.rows[1].z, node.linear.rows[2].z};
  }
  const Vector3 yz = cross(y, z);
  const float inverse = 1 / std::max(dot(x, yz), kFlattened);
  return {inverse * dot(yz, by), inverse * dot(cross(z, x), by), inverse * dot(cross(x, y), by)};
}

}  // namespace physkin

#include "outfit/layer_order.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

#include "evaluator/affine.hpp"
#include "garment/finite.hpp"
#include "outfit/checks.hpp"
#include "outfit/cloth_rows.hpp"

namespace physkin {
namespace {

// [m] between a vertex and the steady layer: a millimetre more than LAYER_GAP, as it holds between vertices.
constexpr float kOrderGap = 0.003f;
// [m] Pushing sets in this much before it must, so that it begins without a kink; the most that it pushes; and over how
// much it fades towards kDeepest.
constexpr float kSoft = 0.001f, kMostPush = 0.05f, kFade = 0.01f;
// A vertex this far [m] off its partner's plane on the right side, or this many mean edge lengths beside it, is free:
// it is looked at only in its turn. One farther off that plane than kNear [m] is right without looking at those around.
constexpr float kFree = 0.01f, kFarAside = 2.0f, kNear = 0.005f;
// [m/s] A push grows or gives way no faster: what must go out far in no time, as where a partner is another all of a
// sudden, would leap.
constexpr float kPushPace = 0.5f;
// In mean edge lengths along the cloth: a vertex farther beside its partner looks for a closer one at once; planes of
// vertices this far do not count. Planes that count less than kFullShare together, as beyond a hem, push less.
constexpr float kLost = 1.0f, kPlaneReach = 1.3f, kFullShare = 0.5f;
// The most that a partner is walked at a time. Times that contacts are looked at in a frame: again those that have
// moved by more than kAgain [m], as in a fold a push meets other cloth.
constexpr int kSteps = 3, kPasses = 4;
constexpr float kAgain = 0.002f;

// Lists padded to whole fours with `filler` of each, so that four entries are looked at together.
struct Fours {
  std::vector<std::int32_t> start{0}, values;

  void add(const std::int32_t* first, const std::int32_t* end, std::int32_t filler) {
    values.insert(values.end(), first, end);
    while (values.size() % 4) values.push_back(filler);
    start.push_back(std::int32_t(values.size()));
  }
};

inline float square_distance(Quad a, Quad b) {
  const Quad gap = a - b, square = gap * gap;
  return square[0] + square[1] + square[2];
}

// The steady vertex that is closest to a point, of those looked at.
struct Closest {
  std::int32_t vertex;
  float square;

  void among(const std::int32_t* four, const std::int32_t* end, Quad at, const ClothRows& steady) {
    for (; four != end; four += 4) {
      Quad gap[4];
      for (int k = 0; k < 4; ++k) gap[k] = at - steady.position(four[k]);
      const Quad squares = sums_of_three(gap[0] * gap[0], gap[1] * gap[1], gap[2] * gap[2], gap[3] * gap[3]);
      for (int k = 0; k < 4; ++k) {
        vertex = squares[k] < square ? four[k] : vertex;
        square = std::min(squares[k], square);
      }
    }
  }
};

}  // namespace

LayerOrderData read_layer_order(FieldSource& source) {
  LayerOrderData d;
  const auto integers = [&](const char* name, int& size) {
    std::vector<int> shape{size};
    const std::int32_t* values = source.integers(name, shape);
    size = shape[0];
    return values;
  };
  d.contact = integers("contact", d.contacts);
  d.seed_start = integers("seed_start", d.seed_starts);
  d.seed = integers("seed", d.seeds);
  std::vector<int> beside_shape{d.contacts, kBeside};
  d.beside = source.integers("beside", beside_shape);
  d.ring_start = integers("ring_start", d.steady_starts);
  d.ring = integers("ring", d.ring_size);
  d.push_start = integers("push_start", d.contact_starts);
  d.push_to = integers("push_to", d.pushes);
  std::vector<int> shape{d.pushes};
  d.push_share = source.floats("push_share", shape);
  d.moved = integers("moved", d.moved_count);
  return d;
}

LayerOrder::LayerOrder(const LayerOrderData& d, Side side, int steady_vertices, int yielding_vertices, Arena& arena)
    : side_(side == Side::kOutside ? 1.0f : -1.0f), contacts_(d.contacts), moved_count_(d.moved_count), edge_(d.edge) {
  check_indices("contact", d.contact, d.contacts, yielding_vertices);
  check_starts("seed_start", d.seed_start, d.seed_starts, d.contacts, d.seeds);
  check_indices("seed", d.seed, d.seeds, steady_vertices);
  check_indices("beside", d.beside, kBeside * std::size_t(d.contacts), d.contacts);
  check_starts("ring_start", d.ring_start, d.steady_starts, steady_vertices, d.ring_size);
  check_indices("ring", d.ring, d.ring_size, steady_vertices);
  check_starts("push_start", d.push_start, d.contact_starts, d.contacts, d.pushes);
  check_indices("push_to", d.push_to, d.pushes, d.moved_count);
  check_finite("push_share", d.push_share, d.pushes, 1.0f);
  check_indices("moved", d.moved, d.moved_count, yielding_vertices);
  check_finite("edge", &d.edge, 1);
  contact_ = arena.copy(d.contact, d.contacts);
  auto* place = arena.take<std::int32_t>(d.contacts);
  std::vector<std::int32_t> place_of(std::size_t(yielding_vertices), -1);
  for (int k = 0; k < d.moved_count; ++k) place_of[d.moved[k]] = k;
  for (int c = 0; c < d.contacts; ++c) {
    place[c] = place_of[d.contact[c]];
    if (place[c] < 0) throw std::invalid_argument("contact[" + std::to_string(c) + "] is not among those moved");
  }
  contact_place_ = place;
  push_start_ = arena.copy(d.push_start, d.contact_starts);
  push_to_ = arena.copy(d.push_to, d.pushes);
  push_share_ = arena.copy(d.push_share, d.pushes);
  moved_ = arena.copy(d.moved, d.moved_count);
  for (float** values : {&push_, &total_, &last_total_}) *values = arena.take<float>(d.moved_count);
  pushed_ = arena.take<std::int32_t>(d.moved_count + 1);
  has_moved_ = arena.take<bool>(d.moved_count);

  Fours planes, seeds;
  auto* plane_count = arena.take<std::int32_t>(steady_vertices);
  std::vector<std::int32_t> around;
  for (int v = 0; v < steady_vertices; ++v) {
    around.assign(1, v);
    around.insert(around.end(), d.ring + d.ring_start[v], d.ring + d.ring_start[v + 1]);
    planes.add(around.data(), around.data() + around.size(), v);
    plane_count[v] = std::int32_t(around.size());
  }
  plane_count_ = plane_count;
  plane_start_ = arena.copy(planes.start.data(), planes.start.size());
  plane_ = arena.copy(planes.values.data(), planes.values.size());
  beside_ = arena.copy(d.beside, kBeside * std::size_t(d.contacts));
  for (std::int32_t** list : {&partner_, &pushed_partner_, &later_, &found_})
    *list = arena.take<std::int32_t>(d.contacts);
  now_ = partner_;
  free_ = arena.take<bool>(d.contacts);
  for (int c = 0; c < d.contacts; ++c) {
    if (d.seed_start[c] == d.seed_start[c + 1]) {
      throw std::invalid_argument("seed_start[" + std::to_string(c) + "]: a contact needs a seed");
    }
    seeds.add(d.seed + d.seed_start[c], d.seed + d.seed_start[c + 1], d.seed[d.seed_start[c]]);
  }
  seed_start_ = arena.copy(seeds.start.data(), seeds.start.size());
  seed_ = arena.copy(seeds.values.data(), seeds.values.size());
  for (std::int32_t** list : {&here_, &searching_, &near_}) *list = arena.take<std::int32_t>(d.contacts + 4);
  forget();
}

void LayerOrder::forget() noexcept {
  for (int c = 0; c < contacts_; ++c) partner_[c] = pushed_partner_[c] = seed_[seed_start_[c]];
  frame_ = 0;
}

void LayerOrder::apply(const VertexRows& steady_rows, const VertexRows& yielding_rows, bool look_at_all,
                       float passed) noexcept {
  const ClothRows steady(steady_rows), yielding(yielding_rows);
  const int turn = frame_++ % kTurns;
  int here = 0, searching = 0;
  for (int c = look_at_all ? 0 : turn; c < contacts_; c += look_at_all ? 1 : kTurns) searching_[searching++] = c;
  for (int c = 0; c < (look_at_all ? 0 : contacts_); ++c) {  // no branches: which contacts are free is hard to foresee
    here_[here] = c;
    here += !free_[c] & (c % kTurns != turn);
  }
  now_ = partner_;
  near_count_ = 0;
  std::fill_n(total_, moved_count_, 0.0f);
  search(look(here, searching, steady, yielding), steady, yielding);
  for (int pass = 1; push_lacking(steady, yielding) && pass < kPasses; ++pass) {
    if (pass == 1) {
      std::copy_n(partner_, contacts_, later_);
      now_ = later_;
    }
    searching = 0;
    for (int c = 0; c < contacts_; ++c) {
      searching_[searching] = c;
      searching += has_moved_[contact_place_[c]];
    }
    near_count_ = 0;
    search(searching, steady, yielding);
    for (int k = 0; k < searching; ++k) pushed_partner_[searching_[k]] = later_[searching_[k]];
  }
  keep_pace(yielding, passed);
}

void LayerOrder::keep_pace(const ClothRows& yielding, float passed) noexcept {
  const float allowed = kPushPace * passed;
  for (int k = 0; passed >= 0 && k < moved_count_; ++k) {
    const float kept = std::clamp(total_[k], last_total_[k] - allowed, last_total_[k] + allowed);
    if (kept != total_[k]) yielding.move(moved_[k], side_ * (kept - total_[k]));
    total_[k] = kept;
  }
  std::swap(total_, last_total_);
}

// Stage by stage for many contacts: what one of them waits for does not hold up the others.
int LayerOrder::look(int here, int searching, const ClothRows& steady, const ClothRows& yielding) noexcept {
  const float most_aside = kLost * edge_;
  for (int k = here; k < here + 3; ++k) here_[k] = here > 0 ? here_[here - 1] : 0;
  for (int first = 0; first < here; first += 4) {
    std::int32_t four[4];
    std::copy_n(here_ + first, 4, four);
    Quad gap[4], normal[4];
    for (int k = 0; k < 4; ++k) {
      const std::int32_t partner = now_[four[k]];
      gap[k] = yielding.position(contact_[four[k]]) - steady.position(partner);
      normal[k] = steady.normal(partner);
    }
    const OffPlanes planes = off_planes(gap, normal);
    for (int k = 0; k < std::min(4, here - first); ++k) {
      const bool lost = planes.aside_square[k] > most_aside * most_aside;
      searching_[searching] = four[k];
      searching += lost;
      settle(four[k], side_ * planes.off[k], planes.aside_square[k], !lost);
    }
  }
  return searching;
}

// All contacts look before one of them changes its partner: what they find does not hang on their order.
void LayerOrder::search(int searching, const ClothRows& steady, const ClothRows& yielding) noexcept {
  for (int k = 0; k < searching; ++k) found_[k] = closest_known(searching_[k], steady, yielding);
  for (int k = 0; k < searching; ++k) walk(searching_[k], found_[k], steady, yielding);
}

inline std::int32_t LayerOrder::closest_known(std::int32_t c, const ClothRows& steady,
                                              const ClothRows& yielding) const noexcept {
  const Quad at = yielding.position(contact_[c]);
  const std::int32_t* beside = beside_ + kBeside * c;
  const std::int32_t known[4] = {pushed_partner_[c], now_[beside[0]], now_[beside[1]], now_[beside[2]]};
  Closest closest{now_[c], square_distance(at, steady.position(now_[c]))};
  closest.among(known, known + 4, at, steady);
  closest.among(seed_ + seed_start_[c], seed_ + seed_start_[c + 1], at, steady);
  return closest.vertex;
}

void LayerOrder::walk(std::int32_t c, std::int32_t from, const ClothRows& steady, const ClothRows& yielding) noexcept {
  const Quad at = yielding.position(contact_[c]);
  Closest closest{from, square_distance(at, steady.position(from))};
  for (int step = 0; step < kSteps; ++step) {
    const std::int32_t before = closest.vertex;
    closest.among(plane_ + plane_start_[before], plane_ + plane_start_[before + 1], at, steady);
    if (closest.vertex == before) break;
  }
  const Quad along = (at - steady.position(closest.vertex)) * steady.normal(closest.vertex);
  const float off = along[0] + along[1] + along[2];
  now_[c] = closest.vertex;
  settle(c, side_ * off, closest.square - off * off, true);
}

inline void LayerOrder::settle(std::int32_t c, float off, float aside_square, bool now) noexcept {
  const float far_aside = kFarAside * edge_;
  const bool free = (off > kFree) | (aside_square > far_aside * far_aside);
  if (now_ == partner_) free_[c] = free;
  near_[near_count_] = c;
  near_count_ += now & !free & !(off > kNear);
}

bool LayerOrder::push_lacking(const ClothRows& steady, const ClothRows& yielding) noexcept {
  bool any = false;
  for (int k = near_count_; k < near_count_ + 3; ++k) near_[k] = near_count_ > 0 ? near_[near_count_ - 1] : 0;
  for (int first = 0; first < near_count_; first += 4) {
    const Quad wanted = lack(near_ + first, steady, yielding);
    for (int k = 0; k < std::min(4, near_count_ - first); ++k) {
      if (!(wanted[k] > 0.0f)) continue;
      if (!any) std::fill_n(push_, moved_count_, 0.0f);
      any = true;
      const std::int32_t c = near_[first + k];
      for (std::int32_t at = push_start_[c]; at < push_start_[c + 1]; ++at) {
        float& push = push_[push_to_[at]];
        const float asked = wanted[k] * push_share_[at];
        push = std::abs(asked) > std::abs(push) ? asked : push;
      }
    }
  }
  if (!any) return false;
  int pushed = 0;
  for (int k = 0; k < moved_count_; ++k) {
    has_moved_[k] = std::abs(push_[k]) > kAgain;
    pushed_[pushed] = k;
    pushed += push_[k] != 0.0f;
  }
  for (int k = 0; k < pushed; ++k) {
    const std::int32_t at = pushed_[k];
    yielding.move(moved_[at], side_ * push_[at]);
    total_[at] += push_[at];
  }
  return true;
}

Quad LayerOrder::lack(const std::int32_t* four, const ClothRows& steady, const ClothRows& yielding) const noexcept {
  const float reach = 1.0f / ((kPlaneReach * edge_) * (kPlaneReach * edge_));
  Quad totals[4], gaps[4], alikes[4];
  for (int k = 0; k < 4; ++k) {
    const Quad at = yielding.position(contact_[four[k]]), own = yielding.normal(contact_[four[k]]);
    const std::int32_t partner = now_[four[k]];
    totals[k] = gaps[k] = alikes[k] = Quad{};
    QuadInts left = plane_count_[partner] - QuadInts{0, 1, 2, 3};
    for (std::int32_t group = plane_start_[partner]; group < plane_start_[partner + 1]; group += 4, left -= 4) {
      const FourRows planes(steady, plane_ + group);
      const Quad x = at[0] - planes.x, y = at[1] - planes.y, z = at[2] - planes.z;
      const Quad off = x * planes.nx + y * planes.ny + z * planes.nz;
      const Quad near = larger(1.0f - (x * x + y * y + z * z - off * off) * reach, Quad{});
      const Quad share = left > 0 ? near * near : Quad{};
      totals[k] += share;
      gaps[k] += share * off;
      alikes[k] += share * (own[0] * planes.nx + own[1] * planes.ny + own[2] * planes.nz);
    }
  }
  const Quad total = sums(totals[0], totals[1], totals[2], totals[3]), safe = larger(total, Quad{} + 1e-6f);
  const Quad gap = side_ * sums(gaps[0], gaps[1], gaps[2], gaps[3]) / safe;
  const Quad alike = sums(alikes[0], alikes[1], alikes[2], alikes[3]) / safe;
  const Quad wanted = larger(kOrderGap + kSoft - gap, Quad{});
  Quad lack = soft_push(wanted, kSoft);
  lack *= smaller(total / kFullShare, Quad{} + 1.0f) * clamp01((kDeepest + gap) / kFade);
  lack *= clamp01(4.0f * alike) / larger(alike, Quad{} + 0.5f);
  return smaller(lack, Quad{} + kMostPush);
}

}  // namespace physkin

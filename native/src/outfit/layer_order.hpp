// The order of two layers on every frame; physkin_core/outfit/layer_order.py says what it does, and binds it.
#pragma once

#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"
#include "outfit/cloth_rows.hpp"

namespace physkin {

// Fields as in LayerOrder of physkin_core/outfit/layer_order.py. Views, read during construction only.
struct LayerOrderData {
  int contacts = -1, seed_starts = -1, seeds = -1, steady_starts = -1, ring_size = -1, contact_starts = -1, pushes = -1,
      moved_count = -1;
  const std::int32_t* contact = nullptr;
  const std::int32_t* seed_start = nullptr;
  const std::int32_t* seed = nullptr;
  const std::int32_t* beside = nullptr;
  const std::int32_t* ring_start = nullptr;
  const std::int32_t* ring = nullptr;
  const std::int32_t* push_start = nullptr;
  const std::int32_t* push_to = nullptr;
  const float* push_share = nullptr;
  const std::int32_t* moved = nullptr;
  float edge = 0.0f;
};

// Reads every field but `edge`; what the arrays hold is for LayerOrder to check.
LayerOrderData read_layer_order(FieldSource& source);

// [m] A vertex farther on the wrong side is of another part of the body.
constexpr float kDeepest = 0.07f;
// Frames in which every vertex has its turn to look for a closer partner; one that lost its own does at once.
constexpr int kTurns = 8;
// Contacts around, by whose partners one finds a closer partner of its own.
constexpr int kBeside = 3;

// Where the yielding layer belongs, seen from the steady one.
enum class Side { kOutside, kInside };

class LayerOrder {
 public:
  // Copies into the arena. Throws std::invalid_argument where an index is out of range or a value is not finite.
  LayerOrder(const LayerOrderData& data, Side side, int steady_vertices, int yielding_vertices, Arena& arena);

  // Moves the yielding layer's positions; rows of both must have normals. look_at_all: do not trust the last frame in
  // where nothing can touch. passed: [s] since that frame, by which pushes keep their pace; negative: that does not
  // count. Allocates nothing.
  void apply(const VertexRows& steady, const VertexRows& yielding, bool look_at_all, float passed) noexcept;
  // The next frame, in which all is to be looked at, is as the first one.
  void forget() noexcept;

 private:
  // Looks at the partners of the `here` contacts of here_: those near them go to near_, those that have lost them to
  // searching_, which has `searching` already. Returns how many search then.
  int look(int here, int searching, const ClothRows& steady, const ClothRows& yielding) noexcept;
  // Finds the partners of contacts of searching_, and adds those near them to near_.
  void search(int searching, const ClothRows& steady, const ClothRows& yielding) noexcept;
  std::int32_t closest_known(std::int32_t contact, const ClothRows& steady, const ClothRows& yielding) const noexcept;
  void walk(std::int32_t contact, std::int32_t from, const ClothRows& steady, const ClothRows& yielding) noexcept;
  void settle(std::int32_t contact, float off, float aside_square, bool now) noexcept;
  // Moves what near contacts lack, and says whether any did.
  bool push_lacking(const ClothRows& steady, const ClothRows& yielding) noexcept;
  void keep_pace(const ClothRows& yielding, float passed) noexcept;
  // What each of four contacts lacks [m].
  Quad lack(const std::int32_t* four, const ClothRows& steady, const ClothRows& yielding) const noexcept;

  float side_;  // 1 outside, -1 inside
  int contacts_, moved_count_;
  float edge_;
  const std::int32_t* contact_;
  const std::int32_t* contact_place_;  // (contacts_,) into moved_
  const std::int32_t* seed_start_;     // (contacts_ + 1,) into seed_, whole fours
  const std::int32_t* seed_;
  const std::int32_t* beside_;    // (contacts_, 3) contacts
  std::int32_t* partner_;         // (contacts_,) before anything is pushed, of the last frame until they are looked at
  std::int32_t* pushed_partner_;  // (contacts_,) when pushed last
  std::int32_t* later_;           // (contacts_,) in this frame's later passes
  std::int32_t* now_;             // partner_, then later_
  std::int32_t* found_;           // of contacts that search
  bool* free_;                    // (contacts_,) when looked at last
  int frame_ = 0;
  const std::int32_t* plane_start_;  // (steady vertices + 1,) into plane_, whole fours
  const std::int32_t* plane_;        // each vertex, its neighbours, and itself again to fill up
  const std::int32_t* plane_count_;  // (steady vertices,) without what fills up
  const std::int32_t* push_start_;
  const std::int32_t* push_to_;
  const float* push_share_;
  const std::int32_t* moved_;
  float* push_;           // (moved_count_,) [m] of one pass
  float* total_;          // (moved_count_,) [m] of all passes
  float* last_total_;     // (moved_count_,) [m] of the last frame, as far as its pace let it go
  bool* has_moved_;       // (moved_count_,) in this pass
  std::int32_t* pushed_;  // list of those among moved_ that a pass pushes
  std::int32_t* here_;    // lists of contacts in one pass
  std::int32_t* searching_;
  std::int32_t* near_;
  int near_count_ = 0;
};

}  // namespace physkin

// Moves the detail nodes of cloth that hangs free, before skinning, in two cases. Where legs, feet or trunk still reach
// into the cloth, because garment nodes lie too far apart to keep it out, detail nodes move out of them. Where a hand or
// a forearm presses on the cloth, or has passed through it, they move towards the body, as far as there is room. Only the
// frame's garment nodes and detail decide. Cloth without detail is not dented.
#pragma once

#include <vector>

#include "evaluator/affine.hpp"
#include "evaluator/cloth_samples.hpp"
#include "evaluator/skin_guard.hpp"
#include "evaluator/skin_part.hpp"
#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

class ClothDents {
 public:
  // Of a garment with samples to dent, and its skin, which outlives this. The data must be valid; they are copied into
  // the arena.
  ClothDents(const BoundGarment& garment, const std::vector<SkinPart>& skin, const Kernels& kernels, Arena& arena);

  // Offsets of detail nodes (detail nodes, 3), dents included: `offsets` itself where there are none. The skin is posed;
  // guard: has moved node_transforms. Allocates nothing.
  const float* dent(const SkinGuard& guard, const float* node_transforms, const float* offsets) noexcept;

 private:
  // A part of the skin, and blocks of samples near it. towards: of an arm, the body, in this frame.
  struct Part {
    const SkinPart& skin;
    float widths[kSkinBones];  // [m] about its axis, within which samples are near, and the largest
    float widest;
    bool* near;  // (blocks,)
    bool any_near;
    Vector3 towards;
    bool is_far = false;  // from all arms
  };

  void place_middles(const float* node_transforms) noexcept;
  // Whether any block is near a part that it may be moved by.
  bool find_near(const SkinGuard& guard) noexcept;
  void find_ways() noexcept;
  // What cloth that is near an arm, or another part of the skin, is to be moved by.
  void press(const Part& arm) noexcept;
  void push(const Part& part, const SkinGuard& guard) noexcept;
  void ask(int sample, float length, Vector3 way) noexcept;
  // Gathers samples near a part that may be moved into points_, and the kernel's word on them into contacts_. Their
  // number.
  template <class May>
  int look_up(const Part& part, May may) noexcept;
  // Samples that something is asked of, into chosen_. Their number.
  int choose_asked() noexcept;
  // Where a sample was placed last.
  Vector3 at(int sample) const {
    return {positions_[sample], positions_[rows_ + sample], positions_[2 * rows_ + sample]};
  }
  // Lessens what arms ask of cloth to the room that there is.
  void keep_room() noexcept;
  int gather(int count) noexcept;
  // How far the rest of the body is from points_, (rows,) [m] into room_, and the way there, (3, rows) into ways_.
  void find_body(int rows) noexcept;
  const float* moved(const float* offsets) noexcept;
  // At rest, what moves a sample `by` in the root frame.
  Vector3 turned_back(int sample, Vector3 by) const noexcept;

  const Kernels& kernels_;
  int nodes_, detail_numbers_;
  ClothSamples cloth_;
  int rows_, middle_rows_;
  std::vector<Part> body_, arms_;
  const float* node_rest_;  // (nodes, 3)
  float* matrices_;         // (nodes, 3, 4)
  float* positions_;        // (3, rows)
  bool* is_near_;           // (blocks,) any part that it may be moved by
  int carriers_each_;
  const std::int32_t* carrying_nodes_;  // (samples, carriers each) garment nodes
  const float* carrying_weights_;       // (samples, carriers each)
  const std::int32_t* carrier_;         // (samples,) the garment node that carries most of each
  int detail_influences_;
  const std::int32_t* influence_nodes_;  // (samples, detail influences)
  const float* influence_weights_;       // (samples, detail influences)
  const std::int32_t* detail_nodes_;     // (samples,)
  const float* shares_;                  // (samples,)
  std::int32_t* middle_carrier_;         // (blocks,) likewise
  float* middle_rest_;                   // (blocks, 3)
  float* middles_;                       // (3, middle rows) posed
  float* radius_;                        // (blocks,) [m] of each about its middle
  bool* is_moved_;                       // (blocks,) whether the guard still had to move a carrier
  float* beyond_;                        // (rows or middle rows,)
  float* points_;                        // (3, rows)
  float* contacts_;                      // (4, rows)
  float* ways_;                          // (3, rows)
  float* room_;                          // (rows,)
  float* sums_;                          // (samples, 4) what is asked of each, as vectors and by how much they count
  std::int32_t* chosen_;                 // (rows,) samples
  bool* is_asked_;                       // (samples,) whether something has been asked of one, and those asked_count_
  std::int32_t* asked_;                  // (samples,)
  int asked_count_ = 0;
  float* moves_;   // (detail numbers,) in the root frame, zeros between frames
  float* dented_;  // (detail numbers,)
};

}  // namespace physkin

// Keeps cloth that hangs free out of legs, hips and trunk: garment nodes that sway through a leg or into the skin sway
// less, and are then moved out along its normal, before skinning, so that all that is skinned to them (vertices,
// points, other meshes) goes along smoothly. What sways remembers nothing of it: it depends on the frame's garment
// nodes alone, and is as smooth in time as they are. physkin_core/runtime/skin_guard.py says which cloth that is, and
// fits the skin.
#pragma once

#include <vector>

#include "evaluator/affine.hpp"
#include "evaluator/cloth_samples.hpp"
#include "evaluator/garment_nodes.hpp"
#include "evaluator/skin_part.hpp"
#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

class SkinGuard {
 public:
  // Of a garment that is guarded, and its skin, which outlives this. The data must be valid; they are copied into the
  // arena.
  SkinGuard(const BoundGarment& garment, const std::vector<SkinPart>& skin, const Kernels& kernels, Arena& arena);

  // What led to the garment nodes of a frame: corrections (nodes, 12), those without sway, or the same, and what detail
  // nodes (detail nodes, 3) are moved by, null without detail.
  struct Cloth {
    const float *corrections, *still, *detail_offsets;
  };

  // Moves node_transforms (nodes, 3, 4). bone_transforms (bones, 3, 4), as which the skin is posed. Allocates nothing.
  void keep_out(const GarmentNodes& nodes, const float* bone_transforms, const Cloth& cloth,
                float* node_transforms) noexcept;

  // Whether garment nodes still had to be moved in the last pass over a frame, and how far one was [m].
  bool any_moved() const { return any_moved_; }
  float moved(int node) const { return moved_[node]; }

 private:
  // Garment nodes whose samples lack less than this [m] together stay.
  static constexpr float kLeast = 1e-9f;

  // A part of the body, and the samples that it may touch.
  struct Part {
    const SkinPart& skin;
    float widths[kSkinBones];  // [m] about its axis, within which samples are looked at
    const float* gaps;         // (samples,) [m]
    const float* ways;         // (samples, 2), null where all are zero
    float reach;               // [m] from which samples are looked at
    std::int32_t* near;        // (rows + 1,) samples in this frame, near_count of them
    int near_count;
  };

  // What a sample lacks [m], the way out of the part of the skin that it is near, and what sway has cost it there.
  struct Lack {
    int sample;
    float length;
    Vector3 normal;
    float cost;
  };

  void place_samples(const float* node_transforms) noexcept;
  // Those that garment nodes which have changed since carry: all, or only those in a block with one near a part.
  void place_changed(const float* node_transforms, bool all) noexcept;
  void find_near(Part& part) noexcept;
  // What samples lack. Whether any lacks something.
  bool find_lacks() noexcept;
  // Where a sample was placed last.
  Vector3 at(int sample) const {
    return {positions_[sample], positions_[rows_ + sample], positions_[2 * rows_ + sample]};
  }
  // Of those near a part, and keeps those that may after a move.
  void add_lacks(Part& part) noexcept;
  // Of a hem that a folding shin has passed the skin's normal leads to the wrong side: turns it, and what is lacking.
  void lead_back(const Part& part, int sample, float depth, Lack& lack) noexcept;
  // Finds sway_, and takes away what leads samples through a leg: on its far side they would lack nothing. Whether
  // anything had to be.
  bool hold_back(const GarmentNodes& nodes, const float* bone_transforms, const Cloth& cloth,
                 float* node_transforms) noexcept;
  // Takes sway away where samples lack something that it has cost them, and leaves what they lack then.
  void sway_less(float* node_transforms) noexcept;
  // A share of sway that is to go, of the garment nodes of a sample (in full of one that `carries` so much of it), and
  // all of these.
  void still(int sample, float share, float carries) noexcept;
  void take_away(float* node_transforms) noexcept;
  // What sway has moved a sample by [m], from sway_ of its garment nodes.
  Vector3 swayed(int sample) const noexcept;
  void move_nodes(float* node_transforms) noexcept;

  const Kernels& kernels_;
  int nodes_;
  ClothSamples cloth_;
  int samples_, rows_, influences_;
  bool *is_near_, *is_carried_;   // (blocks,) a sample of it near a part; and by garment nodes that have changed
  bool* has_changed_;             // (nodes,)
  const float* node_rest_;        // (nodes, 3)
  float *matrices_, *positions_;  // (nodes, 3, 4), and where they put samples, (3, rows)
  float *unswayed_matrices_, *unswayed_positions_;  // the same without sway
  const std::int32_t* influence_nodes_;
  const float* influence_weights_;
  const bool* carries_;  // (nodes, blocks) whether a garment node carries a sample of it
  const float* shares_;  // (samples,)
  std::vector<Part> parts_;
  float* beyond_;  // (rows,) squared [m2], below zero within the width of a part
  float* points_;  // (3, rows) of those near a part, and (4, rows) what the kernel says of them
  float* contacts_;
  float* crossed_;   // (rows,)
  float* unswayed_;  // (nodes, 3, 4) transforms without sway
  Lack* lacks_;      // lack_count_ of them, at most (parts * samples)
  int lack_count_ = 0;
  bool any_moved_ = false;
  bool leads_far_ = false;  // samples that were not near before may be so after a move
  float* sway_;             // (nodes, 3, 4) what it adds to their transforms
  float* stilled_;          // (nodes,) share of sway taken away, 0 to 1
  float* moved_;            // (nodes,) [m] in the last pass
  float* sums_;             // (nodes, 4): what their samples lack in a pass, as vectors and by how much they count
};

}  // namespace physkin

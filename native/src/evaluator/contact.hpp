// Keeps cloth out of the skin: all of a garment, whatever of the body is beneath it or presses on it.
//
// Samples of the cloth, one for each detail node, are looked up on the skin by the facing rule
// (kernels/contact_kernel.hpp). Where cloth that hangs lacks something garment nodes move, so that it goes as a whole. Where
// samples still lack much the vertices between them are looked up, too, and samples that may touch far places of the
// cloth are looked up on these (kernels/cloth_kernel.hpp), and what all of these lack moves detail nodes.
// Vertices, points and other meshes that go with these nodes follow. Nothing is remembered from frame to frame.
// physkin_core/runtime/contact.py chooses the samples.
#pragma once

#include <vector>

#include "evaluator/affine.hpp"
#include "evaluator/skin_surface.hpp"
#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

class Contact {
 public:
  // The data must be valid; they are copied into the arena.
  Contact(const BoundGarment& garment, const Kernels& kernels, Arena& arena);

  // Moves node_transforms (nodes, 3, 4). Returns offsets of detail nodes (detail nodes, 3) with what they are moved by:
  // `offsets` itself where nothing is; null without detail. The skin is posed. Allocates nothing.
  const float* keep_out(const SkinBlocks& skin, float* node_transforms, const float* offsets) noexcept;

  // How far samples, and those between them, are from the skin, and those that may touch far places of the cloth from
  // these, (measured,) [m]; kNoSkin where none is near.
  void measure(const SkinBlocks& skin, const float* node_transforms, const float* offsets, float* clearance) noexcept;
  int measured() const { return samples_ + between_ + own_count_; }
  // Bytes of tables that the last frame had no need of: of vertices between samples, and of what is listed and moved.
  std::size_t untouched() const noexcept;

  static constexpr float kNoSkin = 1.0f;
  // [m] Cloth is moved by what it lacks, from this much before it must, so that it begins without a kink.
  static constexpr float kSoft = 0.002f;

 private:
  // A vector, and a number.
  typedef float Four __attribute__((vector_size(16)));

  // What samples go with and are moved by: garment nodes, or detail nodes.
  struct Movers {
    int count = 0, each = 0;    // of them, and a sample
    const std::int32_t* nodes;  // (samples, and perhaps those between, each)
    const float* weights;       // (samples, and perhaps those between, each)
    float* slack;               // (count,) [m] by how much samples that lack nothing hold each back
    Four* moves;                // (count,) [m] in the root frame
    Four* sums;                 // (count,) what samples lack in a pass, as vectors and by how much they count

    Movers(int count, int each, const std::vector<std::int32_t>& nodes, const std::vector<float>& weights,
           Arena& arena);
    // What they move a sample by.
    Four moved(int sample) const noexcept;
  };

  // A sample that lacks something [m]: where the skin faces, how far it has been moved there, and in how far all that holds.
  struct Near {
    Four normal;
    int sample;
    float lacks, moved, holds;
  };

  void find_samples_around(Arena& arena);
  void place(const float* node_transforms, const float* offsets) noexcept;
  // Looks a block of samples up that has the sides of `block`: planes into `planes_`, and whether any skin is near.
  bool meet(const SkinBlocks& skin, const float* rows, int block) noexcept;
  // Lists a sample, by its place in `planes_`, where it lacks something of a gap: a share of it.
  void list(int sample, int place, float gap, float share) noexcept;
  // Looks samples up on far places of their own cloth: met(its number among them, its place in `planes_`).
  template <class Met>
  void meet_itself(Met met) noexcept;
  float lack_of(const Near& near) const noexcept;
  // Finds moves for what samples lack, a share (samples,) of it each; null: all of it. Whether anything had to be moved.
  bool move(Movers& movers, const float* shares) noexcept;
  // Moves them, and the samples.
  void move_garment_nodes(float* node_transforms) noexcept;
  // Looks up what lies between samples that lack something.
  void look_between(const SkinBlocks& skin) noexcept;
  // Where those of a block between samples are, into `between_rows_`.
  void place_between(int block) noexcept;
  // At rest, what moves a detail node `by` in the root frame.
  Vector3 turned_back(int detail_node, Vector3 by) const noexcept;

  const Kernels& kernels_;
  int node_count_, samples_, between_;
  SkinningBlocks blocks_;
  int skin_rooms_;
  const std::int16_t* sides_;         // (blocks, skin rooms)
  const float* gaps_;                 // (samples and those between,) [m]
  const float* heights_;              // (between,) [m]
  const std::int32_t* block_of_;      // (blocks between,) whose sides are theirs
  const std::int32_t* around_start_;  // (samples + 1,) into the next
  const std::int32_t* around_;        // blocks between that a sample lies around
  const float* node_rest_;            // (nodes, 3)
  float *matrices_, *rows_;           // (nodes, 3, 4), and (samples, kSkinRow) where they put samples: x, y, z, normal
  float *between_rows_, *planes_;
  ContactRoom room_;
  int own_count_;                  // of samples that may touch far places of the cloth
  ClothBlocks own_;                // these
  const std::int16_t* own_sides_;  // (own blocks, rooms)
  const float* own_gaps_;          // (own count,) [m]
  const float* hangs_;             // (samples,) 0 to 1
  Movers garment_nodes_, detail_nodes_;
  const std::int32_t* sample_of_;            // (detail nodes,) the one that goes with each most
  float* most_;                              // (blocks between,) [m] that samples around lack
  Near* near_;                               // near_count_ of them
  int near_count_ = 0, blocks_between_ = 0;  // of them, and of blocks that the last frame has looked at between samples
  float* offsets_;                           // (detail nodes, 3)
};

}  // namespace physkin

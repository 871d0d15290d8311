// Places of a garment that are looked at before it is skinned, in blocks that lie together.
#pragma once

#include <vector>

#include "evaluator/affine.hpp"
#include "evaluator/skinner.hpp"
#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

class ClothSamples {
 public:
  // The data must be valid; they are copied into the arena.
  ClothSamples(const BoundGarment& garment, const ClothSampling& sampling, const Kernels& kernels, Arena& arena);

  int count() const { return count_; }
  int rows() const { return rows_; }  // count, to whole calls of the kernels that look points up
  int blocks() const { return int(blocks_.size()); }
  // Samples of a block: their number, and each by its lane.
  int size(int block) const { return blocks_[block].vertex_count; }
  int sample(int block, int lane) const { return blocks_[block].vertex[lane]; }
  // Places a block's samples. matrices as of `skinning_matrices`; offsets (detail nodes, 3), null without detail.
  void place(int block, const float* matrices, const float* offsets) noexcept;
  // Where they were placed last: (3, rows), and one.
  const float* positions() const { return positions_; }
  Vector3 at(int sample) const { return load_vector(skinned_ + 3 * sample); }

 private:
  const Kernels& kernels_;
  int count_, rows_;
  std::vector<SkinningBlocks> blocks_;  // of one block each
  float* skinned_;                      // (count, 3)
  float* positions_;
};

}  // namespace physkin

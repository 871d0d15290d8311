// Places of a garment that are looked at before it is skinned, in blocks that lie together.
#pragma once

#include <algorithm>

#include "evaluator/affine.hpp"
#include "evaluator/skinner.hpp"
#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

// Samples are counted block by block, kBlock each; only the last block may be short of some.
class ClothSamples {
 public:
  // The data must be valid; they are copied into the arena.
  ClothSamples(const BoundGarment& garment, const ClothSampling& sampling, const Kernels& kernels, Arena& arena);

  int count() const { return blocks_.vertex_count; }
  int blocks() const { return blocks_.block_count; }
  int rows() const { return kBlock * blocks(); }
  // The first sample after a block.
  int end(int block) const { return std::min(kBlock * (block + 1), count()); }

  // Values of the samples as they are given, (count, width), in the order that they are counted in here.
  template <class Value>
  const Value* in_order(const Value* values, int width, Arena& arena) const {
    Value* ordered = arena.take<Value>(std::size_t(count()) * std::size_t(width));
    for (int s = 0; s < count(); ++s) {
      std::copy_n(values + std::ptrdiff_t(blocks_.vertex[s]) * width, width, ordered + std::ptrdiff_t(s) * width);
    }
    return ordered;
  }

  // What follows is of a frame with these offsets (detail nodes, 3), null without detail.
  void begin(const float* offsets) noexcept;
  // Where matrices, as of `skinning_matrices`, put the samples of a block: positions (3, rows), aligned.
  void place(int block, const float* matrices, float* positions) noexcept;
  // Where a sample of a block that has been placed in this frame is at rest, moved by offsets.
  Vector3 at_rest(int sample) const {
    const float* at = at_rest_ + 3 * kBlock * (sample / kBlock) + sample % kBlock;
    return {at[0], at[kBlock], at[2 * kBlock]};
  }

 private:
  const Kernels& kernels_;
  SkinningBlocks blocks_;
  const float* offsets_ = nullptr;
  bool* is_at_rest_;  // (blocks,) whether `at_rest_` is of this frame
  float* at_rest_;    // (blocks, 3, kBlock)
};

}  // namespace physkin

// The skin of a body as points with normals that follow its bones: what cloth is kept out of.
// physkin_core/runtime/contact.py chooses them.
#pragma once

#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

class SkinSurface {
 public:
  // Of a garment's body. The data must be valid; they are copied into the arena.
  SkinSurface(const BoundGarment& garment, const Kernels& kernels, Arena& arena);

  // bone_transforms (bones, 3, 4).
  void pose(const float* bone_transforms) noexcept;
  const SkinBlocks& posed() const { return posed_; }

  // Blocks of a garment's skin, with those that fill the last registers up.
  static int rooms(const BoundGarment& garment) {
    return (garment.skin_points / kSkinBlock + kBlock - 1) / kBlock * kBlock;
  }

 private:
  const Kernels& kernels_;
  SkinningBlocks points_, middles_;
  float *points_rows_, *middle_rows_, *columns_;
  SkinBlocks posed_;
};

}  // namespace physkin

// Parts of a body's skin as smooth surfaces that follow its bones: what cloth is kept out of.
// physkin_core/body_shape/skin_parts.py fits them.
#pragma once

#include <vector>

#include "evaluator/affine.hpp"
#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

// Around each stretch of its axis, from a bone to the next, it lies within a width [m].
struct SkinPart {
  TrunkField field;
  const std::int32_t* bones;
  const float* frame;  // (3, 4) from the canonical pose to the field's own axes
  float* back;         // what field.back points to
  float widths[kSkinBones];
  float axis[3 * (kSkinBones + 1)];  // posed
  bool presses;                      // an arm: cloth is between it and the body

  SkinPart(const BoundGarment& garment, int part, Arena& arena);
  // bone_transforms (bones, 3, 4).
  void pose(const float* bone_transforms) noexcept;
};

// All of a garment. The data must be valid; they are copied into the arena.
std::vector<SkinPart> skin_parts(const BoundGarment& garment, Arena& arena);

// To whole calls of the kernels that look points up.
constexpr int padded_to_points(int count) { return (count + kTrunkPoints - 1) / kTrunkPoints * kTrunkPoints; }

}  // namespace physkin

// Moves garment vertices that skinning leaves inside the posed body onto its surface, in bounded work.
// The method and the meaning of every array: physkin_core/push_out.py.
#pragma once

#include "arena.hpp"
#include "kernels.hpp"

namespace physkin {

// Views of the caller's arrays, read during construction only. Mirrors BoundPushOut in physkin_core/push_out.py.
struct BoundPushOut {
  int body_count = 0, candidate_count = 0, influences = 0, block_count = 0, listed_count = 0;

  const float* body_vertices = nullptr;           // (body_count, 3) canonical pose; candidates first
  const float* body_normals = nullptr;            // (body_count, 3) unit
  const std::int32_t* body_bones = nullptr;       // (body_count, influences)
  const float* body_weights = nullptr;            // (body_count, influences)
  const float* body_bend = nullptr;               // (candidate_count,)
  const std::int32_t* body_patch = nullptr;       // (candidate_count, kPatch, 3)
  const std::int32_t* block_vertices = nullptr;   // (block_count, kBlock), -1 beyond a block's last
  const std::int32_t* candidate_start = nullptr;  // (block_count + 1,)
  const std::int32_t* candidates = nullptr;       // (listed_count,)
};

// What is left after the push-out: depth in metres of the deepest vertex, and how many are deeper than 0.5 mm.
struct ContactResidual {
  float deepest = 0.0f;
  int left_inside = 0;
};

class PushOut {
 public:
  // Copies and packs; throws std::invalid_argument where a frame would read out of bounds or a value is not finite.
  PushOut(const BoundPushOut& bound, int bones, int garment_vertices, Arena& arena);

  // Moves the garment in `rows`. bone_transforms: (bones, 3, 4) canonical to posed, of this body. Allocates nothing.
  ContactResidual apply(const Kernels& kernels, const float* bone_transforms, const VertexRows& rows) noexcept;

 private:
  SkinningBlocks body_;
  ContactBlocks blocks_;
  const std::int32_t* patches_;
  float* posed_;  // (body_count, kBodyRow)
  NearVertex* near_;
};

}  // namespace physkin

// A garment model bound to one body: what the evaluator is built from. Mirrors physkin_core/bound_garment.py.
#pragma once

#include <cstdint>
#include <vector>

namespace physkin {

enum class Activation { none, silu, relu };

struct DenseWeights {
  int outputs = 0, inputs = 0;
  const float* matrix = nullptr;  // (outputs, inputs)
  const float* bias = nullptr;    // (outputs,)
};

// Views of the caller's arrays, read during construction only. Metres, radians, root frame.
struct BoundGarment {
  int bones = 0, dofs = 0, nodes = 0, vertex_count = 0, influences = 0, deformer_bone_count = 0, face_count = 0;
  int modulation_size = 0;

  const std::int32_t* bone_parents = nullptr;  // (bones,) parent before child, -1 for the root
  const float* bone_heads = nullptr;           // (bones, 3) joint centres at the canonical pose

  const std::int32_t* dof_bone = nullptr;  // (dofs,)
  const float* dof_axis = nullptr;         // (dofs, 3) unit
  const float* dof_rest = nullptr;         // (dofs,) joint position at which the bone is at its canonical rotation
  const float* dof_lower = nullptr;        // (dofs,)
  const float* dof_upper = nullptr;        // (dofs,)

  Activation activation = Activation::silu;
  std::vector<DenseWeights> pose_layers;
  const float* pose_modulation = nullptr;  // (modulation_size,) of every hidden activation, or none: it is folded in
  const std::int32_t* deformer_bones = nullptr;  // (deformer_bone_count,)
  std::vector<DenseWeights> deformer_layers;

  const std::int32_t* node_bone = nullptr;  // (nodes,)
  const float* node_positions = nullptr;    // (nodes, 3) canonical pose of this body
  const float* node_rest = nullptr;         // (nodes, 3) garment at rest

  const float* vertices = nullptr;                // (vertex_count, 3) garment at rest
  const float* normals = nullptr;                 // (vertex_count, 3) unit
  const std::int32_t* influence_nodes = nullptr;  // (vertex_count, influences)
  const float* influence_weights = nullptr;       // (vertex_count, influences)
  const std::int32_t* faces = nullptr;            // (face_count, 3), none for a point set
};

// Throws std::invalid_argument where the evaluator would read out of bounds or divide by zero, or a value is not
// finite.
void validate(const BoundGarment& garment);

}  // namespace physkin

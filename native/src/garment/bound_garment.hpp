// A garment model bound to one body: what the evaluator is built from. The fields are those of BoundGarment in
// physkin_core/runtime/bound_garment.py and mean the same.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "kernels/packed_layer.hpp"

namespace physkin {

// What skinning takes, besides the garment nodes' transforms. Views of the caller's arrays, read during construction
// only. Sizes are -1 until they are known.
struct SkinningData {
  int nodes = -1, vertex_count = -1, influences = -1, face_count = -1;

  const float* node_rest = nullptr;               // (nodes, 3) garment at rest
  const float* vertices = nullptr;                // (vertex_count, 3) garment at rest
  const float* normals = nullptr;                 // (vertex_count, 3) unit
  const std::int32_t* influence_nodes = nullptr;  // (vertex_count, influences)
  const float* influence_weights = nullptr;       // (vertex_count, influences)
  const std::int32_t* faces = nullptr;            // (face_count, 3), none for a point set

  // Offsets of rest vertices by features of a frame, through detail nodes that each vertex goes with; or none.
  int detail_vertices = -1, detail_influences = -1, detail_numbers = -1, detail_features = -1;
  const std::int32_t* detail_nodes = nullptr;  // (detail_vertices, detail_influences)
  const float* detail_weights = nullptr;       // (detail_vertices, detail_influences)
  const float* detail_offsets = nullptr;       // (detail_numbers, detail_features) x, y, z of each detail node
  bool has_detail() const { return detail_vertices > 0; }
};

// Places of a garment at rest that are looked at before it is skinned.
struct ClothSampling {
  int samples = -1, influences = -1, detail_influences = -1;
  const float* vertices = nullptr;                // (samples, 3)
  const std::int32_t* influence_nodes = nullptr;  // (samples, influences)
  const float* influence_weights = nullptr;       // (samples, influences)
  const std::int32_t* detail_nodes = nullptr;     // (samples, detail_influences), none without detail
  const float* detail_weights = nullptr;          // (samples, detail_influences)
};

// Metres, radians, root frame.
struct BoundGarment : SkinningData {
  int bones = -1, dofs = -1, deformer_bone_count = -1;
  int sway_joint_count = -1, sway_states = -1, sway_thigh_count = -1;
  int skin_parts = -1, skin_splines = -1;

  const std::int32_t* bone_parents = nullptr;  // (bones,) parent before child, -1 for the root
  const float* bone_heads = nullptr;           // (bones, 3) joint centres at the canonical pose

  const std::int32_t* dof_bone = nullptr;  // (dofs,)
  const float* dof_axis = nullptr;         // (dofs, 3) unit
  const float* dof_rest = nullptr;         // (dofs,) joint position at which the bone is at its canonical rotation
  const float* dof_lower = nullptr;        // (dofs,)
  const float* dof_upper = nullptr;        // (dofs,)

  std::vector<DenseWeights> pose_layers;         // the body's modulation is folded in
  const std::int32_t* deformer_bones = nullptr;  // (deformer_bone_count,)
  std::vector<DenseWeights> deformer_layers;

  // Other fabrics that it can be made of instead, or none. See GarmentEvaluator::set_fabric.
  int fabrics = -1, fabric_modulation = -1, fabric_sway = -1;
  const float* fabric_modulations = nullptr;  // (fabrics, fabric_modulation) of the pose modulator's hidden activations
  const float* fabric_weights = nullptr;      // (fabrics,) how many times as heavy
  const float* fabric_sway_shifts = nullptr;  // (fabrics, fabric_sway) of the first hidden activations of both parts of
                                              // the sway network

  std::vector<DenseWeights> detail_layers;  // one, from the node deformer's last hidden layer to features, or none

  const std::int32_t* node_bone = nullptr;  // (nodes,)
  const float* node_positions = nullptr;    // (nodes, 3) canonical pose of this body
  // How garment nodes sway as joints and root move, or none: they do not.
  const std::int32_t* sway_joints = nullptr;  // (sway_joint_count,) that it looks at
  std::vector<DenseWeights> sway_layers;
  const float* sway_rates = nullptr;          // (sway_states,) 1/s
  const float* sway_turns = nullptr;          // (sway_states,) rad/s
  const std::int32_t* sway_thighs = nullptr;  // (sway_thigh_count,) bones that hold sway back where they are raised
  bool sways_by_network() const { return !sway_layers.empty(); }
  // Samples of cloth that hangs free, and the skin that they are kept out of; or none. See SkinGuard.
  ClothSampling guard;
  const float* guard_shares = nullptr;  // (guard samples,) how free each hangs, 0 to 1
  const float* guard_gaps = nullptr;    // (skin_parts, guard samples) kept from the part's skin
  const float* guard_ways = nullptr;    // (skin_parts, guard samples, 2) back over a shin, in the part's x, y
  // Samples of the same cloth, one a detail node; or none. See ClothDents.
  ClothSampling dent;
  const std::int32_t* dent_nodes = nullptr;    // (dent samples,) detail node of each
  const float* dent_shares = nullptr;          // (dent samples,) how free each hangs, 0 to 1
  const float* skin_frames = nullptr;          // (skin_parts, 3, 4) from the canonical pose to the part's own axes
  const float* skin_shapes = nullptr;          // (skin_parts, 5) x, y, low, high, blend as in TrunkField
  const std::int32_t* skin_bones = nullptr;    // (skin_parts, kSkinBones)
  const std::int32_t* skin_presses = nullptr;  // (skin_parts,) 1 of an arm: cloth is between it and the body; else 0
  const float* skin_heights = nullptr;         // (skin_parts, kSkinBones) that each takes over at; kNoHeight: none
  const float* skin_coefficients = nullptr;    // (skin_parts, skin_splines, kTrunkWaves)
  bool is_guarded() const { return guard.samples > 0 && skin_parts > 0; }
  bool is_dented() const { return is_guarded() && dent.samples > 0; }
};

// Bones of a part of the skin, and the height of one that is not there.
constexpr int kSkinBones = 4;
constexpr float kNoHeight = 1e3f;

// Where fields are read from, by name. A negative size in `shape` allows any and is filled in; a field that is missing,
// or of another type or shape, is refused by an exception of the source's own.
class FieldSource {
 public:
  virtual ~FieldSource() = default;
  virtual const float* floats(const std::string& name, std::vector<int>& shape) = 0;
  virtual const std::int32_t* integers(const std::string& name, std::vector<int>& shape) = 0;
  virtual std::vector<DenseWeights> layers(const std::string& name) = 0;
};

// Of the bound garment file: raised when the fields of a garment change, or the file's form.
constexpr std::uint32_t kBoundFileVersion = 11;

// Reads every field; what the arrays hold is for `validate` to check.
SkinningData read_skinning_data(FieldSource& source);
BoundGarment read_bound_garment(FieldSource& source);

// One field as others are to know it: "float32", "int32" or "layers", and whether its rows are vertices.
struct FieldDescription {
  std::string name, type;
  bool per_vertex;
};
std::vector<FieldDescription> bound_garment_fields();

// Throws std::invalid_argument where the evaluator would read out of bounds or divide by zero, or a value is not
// finite.
void validate(const SkinningData& data);
void validate(const BoundGarment& garment);

}  // namespace physkin

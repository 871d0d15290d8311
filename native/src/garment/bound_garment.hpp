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

  // Detail nodes that each vertex goes with, whose offsets in a frame move rest vertices; or none. detail_numbers: x, y
  // and z of each of them.
  int detail_vertices = -1, detail_influences = -1, detail_numbers = -1;
  const std::int32_t* detail_nodes = nullptr;  // (detail_vertices, detail_influences)
  const float* detail_weights = nullptr;       // (detail_vertices, detail_influences)
  bool has_detail() const { return detail_vertices > 0; }
};

// Places of a garment at rest that are looked at before it is skinned.
struct ClothSampling {
  int samples = -1, influences = -1, detail_influences = -1;
  const float* vertices = nullptr;                // (samples, 3)
  const float* normals = nullptr;                 // (samples, 3) unit
  const std::int32_t* influence_nodes = nullptr;  // (samples, influences)
  const float* influence_weights = nullptr;       // (samples, influences)
  const std::int32_t* detail_nodes = nullptr;     // (samples, detail_influences), none without detail
  const float* detail_weights = nullptr;          // (samples, detail_influences)
};

// Metres, radians, root frame.
struct BoundGarment : SkinningData {
  int bones = -1, dofs = -1, deformer_bone_count = -1;
  int sway_joint_count = -1, sway_states = -1, sway_thigh_count = -1;
  int skin_points = -1, skin_influences = -1, contact_blocks = -1, skin_blocks = -1;
  int between = -1, between_block_count = -1;
  int touching = -1, touching_blocks = -1, touching_other_blocks = -1;

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
  std::vector<DenseWeights> fabric_pose_layers;  // in place of pose_layers
  const float* fabric_modulations = nullptr;  // (fabrics, fabric_modulation) of the pose modulator's hidden activations
  const float* fabric_weights = nullptr;      // (fabrics,) how many times as heavy
  const float* fabric_sway_shifts = nullptr;  // (fabrics, fabric_sway) of the first hidden activations of both parts of
                                              // the sway network

  // One, from the node deformer's last hidden layer to features, or none; and what a feature of 1 adds to x, y and z of
  // each detail node.
  std::vector<DenseWeights> detail_layers;
  int detail_features = -1;
  const float* detail_offsets = nullptr;  // (detail_numbers, detail_features)

  const std::int32_t* node_bone = nullptr;  // (nodes,)
  const float* node_positions = nullptr;    // (nodes, 3) canonical pose of this body
  // How garment nodes sway as joints and root move, or none: they do not.
  const std::int32_t* sway_joints = nullptr;  // (sway_joint_count,) that it looks at
  std::vector<DenseWeights> sway_layers;
  const float* sway_rates = nullptr;          // (sway_states,) 1/s
  const float* sway_turns = nullptr;          // (sway_states,) rad/s
  const std::int32_t* sway_thighs = nullptr;  // (sway_thigh_count,) bones that hold sway back where they are raised
  bool sways_by_network() const { return !sway_layers.empty(); }
  // The body's skin and samples of the cloth that is kept out of it; or none. See Contact.
  const float* skin_positions = nullptr;     // (skin_points, 3) canonical pose, in blocks of kSkinBlock
  const float* skin_normals = nullptr;       // (skin_points, 3) unit
  const std::int32_t* skin_bones = nullptr;  // (skin_points, skin_influences)
  const float* skin_weights = nullptr;       // (skin_points, skin_influences)
  ClothSampling contact;
  const float* contact_gaps = nullptr;          // (contact samples,) kept from the skin
  const float* contact_hangs = nullptr;         // (contact samples,) how free each hangs, 0 to 1
  const std::int32_t* contact_sides = nullptr;  // (blocks of kBlock samples, blocks of skin) 1, -1 or 0 as of meet_skin
  // Samples that may touch far places of the cloth, in blocks of kBlock, or none.
  const std::int32_t* touching_samples = nullptr;  // (touching,)
  const float* touching_gaps = nullptr;            // (touching,) kept from there
  const std::int32_t* touching_sides = nullptr;    // (touching_blocks, touching_other_blocks) as of meet_cloth
  // Vertices between these samples, in blocks of kBlock; none without detail.
  const std::int32_t* between_nodes = nullptr;   // (between, detail influences) detail nodes they go with
  const float* between_weights = nullptr;        // (between, detail influences)
  const float* between_heights = nullptr;        // (between,) off the mean of those nodes' samples, along the normal
  const float* between_gaps = nullptr;           // (between,) kept from the skin
  const std::int32_t* between_blocks = nullptr;  // (between_block_count,) block of samples whose sides they have
  bool meets_skin() const { return contact.samples > 0 && skin_points > 0; }
};

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
constexpr std::uint32_t kBoundFileVersion = 14;

// Reads every field; what the arrays hold is for `validate` to check. detail_nodes: how many there are; throws
// std::invalid_argument where that is no number of detail nodes.
SkinningData read_skinning_data(FieldSource& source, std::int64_t detail_nodes);
// x, y and z of so many detail nodes; throws likewise.
int numbers_of_detail(std::int64_t detail_nodes);
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

#include "bound_file.hpp"

#include "tensor_file.hpp"

namespace physkin {
namespace {

constexpr char kFormat[] = "physkin-bound-garment", kVersion[] = "1";

// Arrays of one file into one arena, by name.
class Reader {
 public:
  Reader(TensorFile& file, Arena& arena) : file_(file), arena_(arena) {}

  const float* floats(const std::string& name, std::vector<int> shape) {
    return file_.floats(name, shape, arena_);
  }
  const std::int32_t* integers(const std::string& name, std::vector<int> shape) {
    return file_.integers(name, shape, arena_);
  }
  // The same, leaving in `size` what the file has as the size of the axis that allows any.
  const float* floats(const std::string& name, std::vector<int> shape, std::size_t axis, int& size) {
    const float* values = file_.floats(name, shape, arena_);
    size = shape[axis];
    return values;
  }
  const std::int32_t* integers(const std::string& name, std::vector<int> shape, std::size_t axis, int& size) {
    const std::int32_t* values = file_.integers(name, shape, arena_);
    size = shape[axis];
    return values;
  }

  std::vector<DenseWeights> layers(const std::string& name) {
    std::vector<DenseWeights> layers;
    for (std::string at = name + ".0"; file_.contains(at + ".weight"); at = name + "." + std::to_string(layers.size())) {
      std::vector<int> shape{-1, -1};
      DenseWeights layer;
      layer.matrix = file_.floats(at + ".weight", shape, arena_);
      layer.outputs = shape[0];
      layer.inputs = shape[1];
      layer.bias = floats(at + ".bias", {layer.outputs});
      layers.push_back(layer);
    }
    return layers;
  }

 private:
  TensorFile& file_;
  Arena& arena_;
};

void read_garment(Reader from, BoundGarment& g) {
  g.bone_parents = from.integers("bone_parents", {-1}, 0, g.bones);
  g.bone_heads = from.floats("bone_heads", {g.bones, 3});
  g.dof_bone = from.integers("dof_bone", {-1}, 0, g.dofs);
  g.dof_axis = from.floats("dof_axis", {g.dofs, 3});
  g.dof_rest = from.floats("dof_rest", {g.dofs});
  g.dof_lower = from.floats("dof_lower", {g.dofs});
  g.dof_upper = from.floats("dof_upper", {g.dofs});
  g.pose_layers = from.layers("pose_layers");
  g.pose_modulation = from.floats("pose_modulation", {-1}, 0, g.modulation_size);
  g.deformer_bones = from.integers("deformer_bones", {-1}, 0, g.deformer_bone_count);
  g.deformer_layers = from.layers("deformer_layers");
  g.node_bone = from.integers("node_bone", {-1}, 0, g.nodes);
  g.node_positions = from.floats("node_positions", {g.nodes, 3});
  g.node_rest = from.floats("node_rest", {g.nodes, 3});
  g.vertices = from.floats("vertices", {-1, 3}, 0, g.vertex_count);
  g.normals = from.floats("normals", {g.vertex_count, 3});
  g.influence_nodes = from.integers("influence_nodes", {g.vertex_count, -1}, 1, g.influences);
  g.influence_weights = from.floats("influence_weights", {g.vertex_count, g.influences});
  g.faces = from.integers("faces", {-1, 3}, 0, g.face_count);
}

}  // namespace

BoundFile::BoundFile(const unsigned char* data, std::size_t size) {
  TensorFile file(data, size);
  if (file.metadata("format") != kFormat) {
    throw FileError("the file is of format '" + file.metadata("format") + "'; expected " + kFormat +
                    ", as `physkin bind` writes it");
  }
  if (file.metadata("schema_version") != kVersion) {
    throw FileError("the file has schema version '" + file.metadata("schema_version") + "'; this library reads " +
                    kVersion);
  }
  read_garment({file, arena}, garment);
  const std::string& activation = file.metadata("activation");
  if (activation != "silu" && activation != "relu") {
    throw FileError("activation is '" + activation + "'; must be silu or relu");
  }
  garment.activation = activation == "silu" ? Activation::silu : Activation::relu;
  joint_names = parse_string_list(file.metadata("joint_names"));
  if (joint_names.size() != std::size_t(garment.dofs)) {
    throw FileError("the file names " + std::to_string(joint_names.size()) + " joints; expected " +
                    std::to_string(garment.dofs));
  }
  if (file.contains("push_out.body_vertices")) {
    throw FileError("the file holds a push-out (push_out.body_vertices), which was removed; write it anew with "
                    "`physkin bind`");
  }
  file.refuse_unread();
}

}  // namespace physkin

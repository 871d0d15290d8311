#include "garment/bound_garment.hpp"

#include <initializer_list>
#include <stdexcept>
#include <string>

#include "garment/finite.hpp"
#include "kernels/kernels.hpp"

namespace physkin {
namespace {

// --- The one list of fields: reading and checking go by it ---

// One axis of an array: a size of the garment, or a number.
struct Axis {
  Axis(int* size) : size(size) {}
  Axis(int number) : number(number) {}
  int value() const { return size == nullptr ? number : *size; }

  int* size = nullptr;
  int number = 0;
};
using Shape = std::initializer_list<Axis>;

// Calls visit.floats(name, array, shape), visit.indices(name, array, shape, lowest, limit): values are from `lowest` to
// below the size `limit`.
template <class Visitor>
void visit_skinning_data(SkinningData& d, Visitor&& visit) {
  visit.floats("node_rest", d.node_rest, {&d.nodes, 3});
  visit.floats("vertices", d.vertices, {&d.vertex_count, 3});
  visit.floats("normals", d.normals, {&d.vertex_count, 3});
  visit.indices("influence_nodes", d.influence_nodes, {&d.vertex_count, &d.influences}, 0, d.nodes);
  visit.floats("influence_weights", d.influence_weights, {&d.vertex_count, &d.influences});
  visit.indices("faces", d.faces, {&d.face_count, 3}, 0, d.vertex_count);
  visit.indices("detail_nodes", d.detail_nodes, {&d.detail_vertices, &d.detail_influences}, 0, d.detail_numbers / 3);
  visit.floats("detail_weights", d.detail_weights, {&d.detail_vertices, &d.detail_influences});
}

template <class Visitor>
void visit_sampling(const BoundGarment& g, const std::string& prefix, ClothSampling& of, Visitor&& visit) {
  visit.floats((prefix + "vertices").c_str(), of.vertices, {&of.samples, 3});
  visit.floats((prefix + "normals").c_str(), of.normals, {&of.samples, 3});
  visit.indices((prefix + "influence_nodes").c_str(), of.influence_nodes, {&of.samples, &of.influences}, 0, g.nodes);
  visit.floats((prefix + "influence_weights").c_str(), of.influence_weights, {&of.samples, &of.influences});
  visit.indices((prefix + "detail_nodes").c_str(), of.detail_nodes, {&of.samples, &of.detail_influences}, 0,
                g.detail_numbers / 3);
  visit.floats((prefix + "detail_weights").c_str(), of.detail_weights, {&of.samples, &of.detail_influences});
}

// The same, and visit.layers(name, layers).
template <class Visitor>
void visit_bound_garment(BoundGarment& g, Visitor&& visit) {
  visit.indices("bone_parents", g.bone_parents, {&g.bones}, -1, g.bones);
  visit.floats("bone_heads", g.bone_heads, {&g.bones, 3});
  visit.indices("dof_bone", g.dof_bone, {&g.dofs}, 0, g.bones);
  visit.floats("dof_axis", g.dof_axis, {&g.dofs, 3});
  visit.floats("dof_rest", g.dof_rest, {&g.dofs});
  visit.floats("dof_lower", g.dof_lower, {&g.dofs});
  visit.floats("dof_upper", g.dof_upper, {&g.dofs});
  visit.layers("pose_layers", g.pose_layers);
  visit.layers("fabric_pose_layers", g.fabric_pose_layers);
  visit.floats("fabric_modulations", g.fabric_modulations, {&g.fabrics, &g.fabric_modulation});
  visit.floats("fabric_weights", g.fabric_weights, {&g.fabrics});
  visit.floats("fabric_sway_shifts", g.fabric_sway_shifts, {&g.fabrics, &g.fabric_sway});
  visit.indices("deformer_bones", g.deformer_bones, {&g.deformer_bone_count}, 0, g.bones);
  visit.layers("deformer_layers", g.deformer_layers);
  visit.layers("detail_layers", g.detail_layers);
  visit.floats("detail_offsets", g.detail_offsets, {&g.detail_numbers, &g.detail_features});
  visit.indices("node_bone", g.node_bone, {&g.nodes}, 0, g.bones);
  visit.floats("node_positions", g.node_positions, {&g.nodes, 3});
  visit.indices("sway_joints", g.sway_joints, {&g.sway_joint_count}, 0, g.dofs);
  visit.layers("sway_layers", g.sway_layers);
  visit.floats("sway_rates", g.sway_rates, {&g.sway_states});
  visit.floats("sway_turns", g.sway_turns, {&g.sway_states});
  visit.indices("sway_thighs", g.sway_thighs, {&g.sway_thigh_count}, 0, g.bones);
  visit_skinning_data(g, visit);
  visit.floats("skin_positions", g.skin_positions, {&g.skin_points, 3});
  visit.floats("skin_normals", g.skin_normals, {&g.skin_points, 3});
  visit.indices("skin_bones", g.skin_bones, {&g.skin_points, &g.skin_influences}, 0, g.bones);
  visit.floats("skin_weights", g.skin_weights, {&g.skin_points, &g.skin_influences});
  visit_sampling(g, "contact_", g.contact, visit);
  visit.floats("contact_gaps", g.contact_gaps, {&g.contact.samples});
  visit.floats("contact_hangs", g.contact_hangs, {&g.contact.samples});
  visit.indices("contact_sides", g.contact_sides, {&g.contact_blocks, &g.skin_blocks}, -1, 2);
  visit.indices("between_nodes", g.between_nodes, {&g.between, &g.contact.detail_influences}, 0, g.detail_numbers / 3);
  visit.floats("between_weights", g.between_weights, {&g.between, &g.contact.detail_influences});
  visit.floats("between_heights", g.between_heights, {&g.between});
  visit.floats("between_gaps", g.between_gaps, {&g.between});
  visit.indices("between_blocks", g.between_blocks, {&g.between_block_count}, 0, g.contact_blocks);
  visit.indices("touching_samples", g.touching_samples, {&g.touching}, 0, g.contact.samples);
  visit.floats("touching_gaps", g.touching_gaps, {&g.touching});
  visit.indices("touching_sides", g.touching_sides, {&g.touching_blocks, &g.touching_other_blocks}, -1, 3);
}

// --- Reading ---

struct Reader {
  FieldSource& source;

  // The first array with a size gives it to the garment, the others must have the same.
  template <class Read>
  static auto sized(Shape shape, Read read) {
    std::vector<int> sizes;
    for (const Axis& axis : shape) sizes.push_back(axis.value());
    const auto values = read(sizes);
    std::size_t at = 0;
    for (const Axis& axis : shape) {
      if (axis.size != nullptr) *axis.size = sizes[at];
      ++at;
    }
    return values;
  }

  void floats(const char* name, const float*& values, Shape shape) const {
    values = sized(shape, [&](std::vector<int>& sizes) { return source.floats(name, sizes); });
  }
  void indices(const char* name, const std::int32_t*& values, Shape shape, int, int) const {
    values = sized(shape, [&](std::vector<int>& sizes) { return source.integers(name, sizes); });
  }
  void layers(const char* name, std::vector<DenseWeights>& layers) const { layers = source.layers(name); }
};

// --- Describing ---

struct Describer {
  const BoundGarment& g;
  std::vector<FieldDescription>& fields;

  void floats(const char* name, const float*, Shape shape) const { add(name, "float32", shape); }
  void indices(const char* name, const std::int32_t*, Shape shape, int, int) const { add(name, "int32", shape); }
  void layers(const char* name, const std::vector<DenseWeights>&) const { fields.push_back({name, "layers", false}); }

  void add(const char* name, const char* type, Shape shape) const {
    const int* rows = shape.begin()->size;
    fields.push_back({name, type, rows == &g.vertex_count || rows == &g.detail_vertices});
  }
};

// --- Checking ---

[[noreturn]] void fail(const std::string& message) { throw std::invalid_argument(message); }

std::string element(const char* name, std::size_t index) {
  return std::string(name) + "[" + std::to_string(index) + "]";
}

void check_layers(const char* name, const std::vector<DenseWeights>& layers, int inputs) {
  if (layers.empty()) fail(std::string(name) + " is empty; it needs at least the linear output layer");
  for (std::size_t k = 0; k < layers.size(); ++k) {
    const DenseWeights& layer = layers[k];
    if (layer.inputs != inputs) {
      fail(element(name, k) + " has " + std::to_string(layer.inputs) + " inputs; expected " + std::to_string(inputs));
    }
    check_finite(element(name, k), layer.matrix, std::size_t(layer.outputs) * layer.inputs);
    if (!layer.is_projection()) {
      check_finite(element(name, k) + " bias", layer.bias, layer.outputs);
    } else if (k + 1 == layers.size()) {
      fail(element(name, k) + " bias is empty; only a projection between other layers has none");
    }
    inputs = layer.outputs;
  }
}

int hidden_activations(const std::vector<DenseWeights>& layers) {
  int hidden = 0;
  for (std::size_t k = 0; k + 1 < layers.size(); ++k) hidden += layers[k].is_projection() ? 0 : layers[k].outputs;
  return hidden;
}

struct Check {
  void floats(const char* name, const float* values, Shape shape) const {
    check_finite(name, values, count(name, shape));
  }
  void indices(const char* name, const std::int32_t* values, Shape shape, int lowest, int limit) const {
    const std::size_t size = count(name, shape);
    for (std::size_t i = 0; i < size; ++i) {
      if (values[i] < lowest || values[i] >= limit) {
        fail(element(name, i) + " is " + std::to_string(values[i]) + "; must be in [" + std::to_string(lowest) + ", " +
             std::to_string(limit) + ")");
      }
    }
  }
  void layers(const char*, const std::vector<DenseWeights>&) const {}  // their sizes depend on each other: see below

  static std::size_t count(const char* name, Shape shape) {
    std::size_t product = 1;
    for (const Axis& axis : shape) {
      if (axis.value() < 0) fail(std::string(name) + " has a size below zero");
      product *= std::size_t(axis.value());
    }
    return product;
  }
};

// A sway network: two layers from the drive to the oscillators, three from these, pose and drive to garment nodes.
void check_sway(const BoundGarment& g) {
  const std::vector<DenseWeights>& layers = g.sway_layers;
  if (layers.empty()) {
    if (g.sway_joint_count > 0 || g.sway_states > 0) fail("sway_joints, sway_rates or sway_turns without sway_layers");
    return;
  }
  if (layers.size() != 5) fail("sway_layers are " + std::to_string(layers.size()) + "; expected none or 5");
  const int joints = g.sway_joint_count, states = g.sway_states, drive = 2 * joints + 15, pose = joints + 3;
  check_layers("sway_layers of the drive", {layers[0], layers[1]}, drive);
  check_layers("sway_layers of the states", {layers[2], layers[3], layers[4]}, 2 * states + pose + drive);
  if (layers[1].outputs != 3 * states) {
    fail("sway_layers[1] gives " + std::to_string(layers[1].outputs) + " values; expected 3 for each of " +
         std::to_string(states) + " oscillators");
  }
  if (layers[4].outputs != 12 * g.nodes) {
    fail("sway_layers give " + std::to_string(layers[4].outputs) + " values; expected 12 for each of " +
         std::to_string(g.nodes) + " garment nodes");
  }
  for (int k = 0; k < states; ++k) {
    if (!(g.sway_rates[k] > 0))
      fail(element("sway_rates", k) + " is " + std::to_string(g.sway_rates[k]) + "; must be above 0");
  }
}

// Other fabrics, of networks that have been checked.
void check_fabrics(const BoundGarment& g) {
  if (g.fabrics == 0) return;
  check_layers("fabric_pose_layers", g.fabric_pose_layers, g.dofs + 3);
  if (g.fabric_pose_layers.back().outputs != g.pose_layers.back().outputs) {
    fail("fabric_pose_layers give " + std::to_string(g.fabric_pose_layers.back().outputs) +
         " values; expected as many as pose_layers, " + std::to_string(g.pose_layers.back().outputs));
  }
  if (g.fabric_modulation != 2 * hidden_activations(g.fabric_pose_layers)) {
    fail("fabric_modulations have " + std::to_string(g.fabric_modulation) +
         " values each; expected a scale and a shift for " + std::to_string(hidden_activations(g.fabric_pose_layers)) +
         " hidden activations of the pose modulator");
  }
  const int shifts = g.sway_layers.empty() ? 0 : g.sway_layers[0].outputs + g.sway_layers[2].outputs;
  if (g.fabric_sway != shifts) {
    fail("fabric_sway_shifts have " + std::to_string(g.fabric_sway) + " values each; expected " +
         std::to_string(shifts));
  }
  for (int k = 0; k < g.fabrics; ++k) {
    if (!(g.fabric_weights[k] > 0)) {
      fail(element("fabric_weights", k) + " is " + std::to_string(g.fabric_weights[k]) + "; must be above 0");
    }
  }
}

void check_sampling(const BoundGarment& g, const std::string& prefix, const ClothSampling& of) {
  if (of.samples > 0 && of.influences < 1) fail(prefix + "influence_nodes: a sample needs an influence");
  if (of.samples > 0 && (of.detail_influences > 0) != g.has_detail()) {
    fail(prefix + "detail_nodes are " + std::to_string(of.detail_influences) +
         " a sample; expected none of a garment without detail, and at least one with detail");
  }
}

// Whole blocks of skin, and a side for each block of samples to each of these.
void check_contact(const BoundGarment& g) {
  check_sampling(g, "contact_", g.contact);
  if (g.skin_points % kSkinBlock != 0 || (g.skin_points > 0 && g.skin_influences < 1)) {
    fail("skin_positions are " + std::to_string(g.skin_points) + " with " + std::to_string(g.skin_influences) +
         " bones each; expected a multiple of " + std::to_string(kSkinBlock) + ", with at least one");
  }
  const int blocks = (g.contact.samples + kBlock - 1) / kBlock, skin_blocks = g.skin_points / kSkinBlock;
  if (g.meets_skin() && (g.contact_blocks != blocks || g.skin_blocks != skin_blocks)) {
    fail("contact_sides are " + std::to_string(g.contact_blocks) + " x " + std::to_string(g.skin_blocks) +
         "; expected " + std::to_string(blocks) + " x " + std::to_string(skin_blocks));
  }
  const int touching = g.touching / kBlock;
  if (g.touching % kBlock != 0 || g.touching_blocks != touching || g.touching_other_blocks != touching) {
    fail("touching_sides are " + std::to_string(g.touching_blocks) + " x " + std::to_string(g.touching_other_blocks) +
         "; expected one for each two blocks of " + std::to_string(kBlock) + " of " + std::to_string(g.touching) +
         " touching_samples");
  }
  if (g.between_block_count != (g.between + kBlock - 1) / kBlock) {
    fail("between_blocks are " + std::to_string(g.between_block_count) + "; expected " +
         std::to_string((g.between + kBlock - 1) / kBlock));
  }
}

void check_sizes(const SkinningData& d) {
  if (d.nodes < 1 || d.vertex_count < 1 || d.influences < 1) {
    fail("a garment needs at least one garment node, vertex and influence");
  }
  if (d.detail_vertices != 0 && d.detail_vertices != d.vertex_count) {
    fail("detail_nodes are for " + std::to_string(d.detail_vertices) + " vertices; expected none, or " +
         std::to_string(d.vertex_count));
  }
  if (d.detail_numbers % 3 != 0) {
    fail("detail_offsets have " + std::to_string(d.detail_numbers) + " rows; expected three for each detail node");
  }
  if (d.has_detail() && d.detail_influences < 1) fail("detail needs a detail node a vertex");
}

// The layer that gives the features, where there is detail.
void check_features(const BoundGarment& g) {
  if (g.detail_layers.size() != (g.has_detail() ? 1u : 0u)) {
    fail("detail_layers are " + std::to_string(g.detail_layers.size()) +
         "; expected one with detail, and none without");
  }
  if (!g.has_detail()) return;
  if (g.detail_features < 1) fail("detail needs at least one feature");
  if (g.deformer_layers.size() < 2) fail("detail needs a node deformer with a hidden layer");
  check_layers("detail_layers", g.detail_layers, g.deformer_layers.back().inputs);
  if (g.detail_layers[0].outputs != g.detail_features) {
    fail("detail_layers give " + std::to_string(g.detail_layers[0].outputs) + " features; expected " +
         std::to_string(g.detail_features));
  }
}

}  // namespace

SkinningData read_skinning_data(FieldSource& source, std::int64_t detail_nodes) {
  SkinningData data;
  data.detail_numbers = numbers_of_detail(detail_nodes);
  visit_skinning_data(data, Reader{source});
  return data;
}

int numbers_of_detail(std::int64_t detail_nodes) {
  constexpr std::int64_t kMost = 1 << 24;  // no garment comes near, and three times as many fit an int
  if (detail_nodes < 0 || detail_nodes > kMost) {
    fail("detail_node_count is " + std::to_string(detail_nodes) + "; allowed: 0 to " + std::to_string(kMost));
  }
  return 3 * int(detail_nodes);
}

BoundGarment read_bound_garment(FieldSource& source) {
  BoundGarment garment;
  visit_bound_garment(garment, Reader{source});
  return garment;
}

std::vector<FieldDescription> bound_garment_fields() {
  BoundGarment garment;
  std::vector<FieldDescription> fields;
  visit_bound_garment(garment, Describer{garment, fields});
  return fields;
}

void validate(const SkinningData& data) {
  check_sizes(data);
  SkinningData views = data;
  visit_skinning_data(views, Check{});
}

void validate(const BoundGarment& garment) {
  check_sizes(garment);
  BoundGarment g = garment;
  if (g.bones < 1) fail("a bound garment needs at least one bone");
  visit_bound_garment(g, Check{});
  for (int j = 0; j < g.bones; ++j) {
    if (g.bone_parents[j] >= j) {
      fail(element("bone_parents", j) + " is " + std::to_string(g.bone_parents[j]) +
           "; must be -1 or the index of an earlier bone");
    }
  }
  for (int k = 0; k < g.dofs; ++k) {
    if (!(g.dof_lower[k] < g.dof_upper[k])) {
      fail(element("dof_upper", k) + " is " + std::to_string(g.dof_upper[k]) + "; must be above its lower limit " +
           std::to_string(g.dof_lower[k]));
    }
  }

  check_layers("pose_layers", g.pose_layers, g.dofs + 3);
  check_layers("deformer_layers", g.deformer_layers, 12 * g.deformer_bone_count);
  const int hidden = hidden_activations(g.deformer_layers);
  if (g.pose_layers.back().outputs != 2 * hidden) {
    fail("pose_layers give " + std::to_string(g.pose_layers.back().outputs) +
         " values; expected a scale and a shift for " + std::to_string(hidden) +
         " hidden activations of the node deformer");
  }
  const int outputs = g.deformer_layers.back().outputs;
  if (outputs != 12 * g.nodes) {
    fail("deformer_layers give " + std::to_string(outputs) + " values; expected 12 for each of " +
         std::to_string(g.nodes) + " garment nodes");
  }
  check_features(g);
  check_sway(g);
  check_fabrics(g);
  check_contact(g);
}

}  // namespace physkin

#include "bound_garment.hpp"

#include <stdexcept>
#include <string>

#include "finite.hpp"

namespace physkin {
namespace {

// No length, angle or network weight of a garment comes near; what the kernels make of smaller ones stays finite.
constexpr float kLargest = 1e6f;

[[noreturn]] void fail(const std::string& message) { throw std::invalid_argument(message); }

std::string element(const char* name, std::size_t index) {
  return std::string(name) + "[" + std::to_string(index) + "]";
}

void check_finite(const char* name, const float* values, std::size_t count) {
  const std::size_t bad = first_beyond(values, count, kLargest);
  if (bad < count) {
    fail(element(name, bad) + " (flattened) is " + std::to_string(values[bad]) + "; must be finite and within +-1e6");
  }
}

void check_index(const char* name, const std::int32_t* values, std::size_t count, int limit) {
  for (std::size_t i = 0; i < count; ++i) {
    if (values[i] < 0 || values[i] >= limit) {
      fail(element(name, i) + " (flattened) is " + std::to_string(values[i]) + "; must be in [0, " +
           std::to_string(limit) + ")");
    }
  }
}

void check_layers(const char* name, const std::vector<DenseWeights>& layers, int inputs) {
  if (layers.empty()) fail(std::string(name) + " is empty; it needs at least the linear output layer");
  for (std::size_t k = 0; k < layers.size(); ++k) {
    const DenseWeights& layer = layers[k];
    if (layer.inputs != inputs) {
      fail(element(name, k) + " has " + std::to_string(layer.inputs) + " inputs; expected " + std::to_string(inputs));
    }
    check_finite(element(name, k).c_str(), layer.matrix, std::size_t(layer.outputs) * layer.inputs);
    check_finite((element(name, k) + " bias").c_str(), layer.bias, layer.outputs);
    inputs = layer.outputs;
  }
}

int hidden_activations(const std::vector<DenseWeights>& layers) {
  int hidden = 0;
  for (std::size_t k = 0; k + 1 < layers.size(); ++k) hidden += layers[k].outputs;
  return hidden;
}

}  // namespace

void validate(const BoundGarment& g) {
  if (g.bones < 1 || g.nodes < 1 || g.vertex_count < 1 || g.influences < 1) {
    fail("a bound garment needs at least one bone, garment node, vertex and influence");
  }
  for (int j = 0; j < g.bones; ++j) {
    if (g.bone_parents[j] < -1 || g.bone_parents[j] >= j) {
      fail(element("bone_parents", j) + " is " + std::to_string(g.bone_parents[j]) +
           "; must be -1 or the index of an earlier bone");
    }
  }
  check_index("dof_bone", g.dof_bone, g.dofs, g.bones);
  check_index("deformer_bones", g.deformer_bones, g.deformer_bone_count, g.bones);
  check_index("node_bone", g.node_bone, g.nodes, g.bones);
  check_index("influence_nodes", g.influence_nodes, std::size_t(g.vertex_count) * g.influences, g.nodes);
  check_index("faces", g.faces, 3 * std::size_t(g.face_count), g.vertex_count);

  check_finite("bone_heads", g.bone_heads, 3 * std::size_t(g.bones));
  check_finite("dof_axis", g.dof_axis, 3 * std::size_t(g.dofs));
  check_finite("dof_rest", g.dof_rest, g.dofs);
  check_finite("dof_lower", g.dof_lower, g.dofs);
  check_finite("dof_upper", g.dof_upper, g.dofs);
  check_finite("node_positions", g.node_positions, 3 * std::size_t(g.nodes));
  check_finite("node_rest", g.node_rest, 3 * std::size_t(g.nodes));
  check_finite("vertices", g.vertices, 3 * std::size_t(g.vertex_count));
  check_finite("normals", g.normals, 3 * std::size_t(g.vertex_count));
  check_finite("influence_weights", g.influence_weights, std::size_t(g.vertex_count) * g.influences);
  for (int k = 0; k < g.dofs; ++k) {
    if (!(g.dof_lower[k] < g.dof_upper[k])) {
      fail(element("dof_upper", k) + " is " + std::to_string(g.dof_upper[k]) + "; must be above its lower limit " +
           std::to_string(g.dof_lower[k]));
    }
  }

  check_layers("pose_layers", g.pose_layers, g.dofs + 3);
  check_finite("pose_modulation", g.pose_modulation, g.modulation_size);
  if (g.modulation_size != 0 && g.modulation_size != 2 * hidden_activations(g.pose_layers)) {
    fail("pose_modulation has " + std::to_string(g.modulation_size) + " values; expected none, or a scale and a shift " +
         "for " + std::to_string(hidden_activations(g.pose_layers)) + " hidden activations of the pose modulator");
  }
  check_layers("deformer_layers", g.deformer_layers, 12 * g.deformer_bone_count);
  const int hidden = hidden_activations(g.deformer_layers);
  if (g.pose_layers.back().outputs != 2 * hidden) {
    fail("pose_layers give " + std::to_string(g.pose_layers.back().outputs) +
         " values; expected a scale and a shift for " + std::to_string(hidden) +
         " hidden activations of the node deformer");
  }
  const int outputs = g.deformer_layers.back().outputs;
  if (outputs != 9 * g.nodes && outputs != 12 * g.nodes) {
    fail("deformer_layers give " + std::to_string(outputs) + " values; expected 9 or 12 for each of " +
         std::to_string(g.nodes) + " garment nodes");
  }
}

}  // namespace physkin

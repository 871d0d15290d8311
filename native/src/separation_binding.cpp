// The part of physkin_core._native that separates limbs: checks and converts, computes nothing.
#include "separation_binding.hpp"

#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "kernels/dispatch.hpp"
#include "separation/limb_separator.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace physkin {
namespace {

using Given = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Separated = nb::ndarray<float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

template <class T>
void read(nb::handle shape, const char* name, std::vector<T>& values) {
  nb::ndarray<const T, nb::c_contig, nb::device::cpu> array;
  if (!nb::try_cast(nb::object(shape.attr(name)), array, false)) {
    const char* type = std::is_same_v<T, float> ? "float32" : "int32";
    throw nb::value_error((std::string(name) + " must be a C-contiguous " + type + " array").c_str());
  }
  values.assign(array.data(), array.data() + array.size());
}

void make(LimbSeparator* self, nb::handle object, const SeparationSettings& settings, const std::string& set) {
  CollisionShape shape;
  read(object, "parents", shape.parents);
  read(object, "heads", shape.heads);
  read(object, "dof_bone", shape.dof_bone);
  read(object, "dof_axis", shape.dof_axis);
  read(object, "dof_rest", shape.dof_rest);
  read(object, "dof_lower", shape.dof_lower);
  read(object, "dof_upper", shape.dof_upper);
  read(object, "trunk_bones", shape.trunk_bones);
  read(object, "trunk_heights", shape.trunk_heights);
  read(object, "trunk_frame", shape.trunk_frame);
  read(object, "trunk_coefficients", shape.trunk_coefficients);
  read(object, "sphere_bone", shape.sphere_bone);
  read(object, "sphere_centre", shape.sphere_centre);
  read(object, "sphere_radius", shape.sphere_radius);
  read(object, "sphere_limb", shape.sphere_limb);
  read(object, "sphere_joints", shape.sphere_joints);
  read(object, "capsules", shape.capsules);
  read(object, "groups", shape.groups);
  read(object, "group_reach", shape.group_reach);
  read(object, "pairs", shape.pairs);
  read(object, "allowed", shape.allowed);
  read(object, "limb_start", shape.limb_start);
  read(object, "limb_dofs", shape.limb_dofs);
  read(object, "limb_kind", shape.limb_kind);
  new (self) LimbSeparator(std::move(shape), settings, select_kernels(set));
}

float separate(LimbSeparator& self, const Given& joint_positions, const Separated& out) {
  if (joint_positions.size() != std::size_t(self.dofs()) || out.size() != std::size_t(self.dofs())) {
    throw nb::value_error(("joint_positions and out must have shape (" + std::to_string(self.dofs()) + ",)").c_str());
  }
  float change = 0.0f;
  if (const Rejection bad = self.separate(joint_positions.data(), out.data(), &change)) {
    throw nb::value_error(bad.message().c_str());
  }
  return change;
}

}  // namespace

void bind_separation(nb::module_& module) {
  nb::class_<LimbSeparator>(module, "LimbSeparator")
      .def(
          "__init__",
          [](LimbSeparator* self, nb::handle shape, float onset, float softness, float pull, float damping, float blend,
             int steps, const std::optional<std::string>& instruction_set) {
            make(self, shape, {onset, softness, pull, damping, blend, steps}, instruction_set.value_or(""));
          },
          "shape"_a, "onset"_a, "softness"_a, "pull"_a, "damping"_a, "blend"_a, "steps"_a,
          "instruction_set"_a = nb::none())
      .def("separate", &separate, "joint_positions"_a.noconvert(), "out"_a.noconvert());
}

}  // namespace physkin

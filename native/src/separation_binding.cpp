// The part of physkin_core._native that separates limbs: checks and converts, computes nothing.
#include "bindings.hpp"
#include "kernels/dispatch.hpp"
#include "python_arrays.hpp"
#include "separation/limb_separator.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace physkin {
namespace {

template <class T>
void read(nb::handle shape, const char* name, std::vector<T>& values) {
  nb::ndarray<const T, nb::c_contig, nb::device::cpu> array;
  if (!nb::try_cast(nb::object(shape.attr(name)), array, false)) {
    const char* type = std::is_same_v<T, float> ? "float32" : "int32";
    throw std::invalid_argument(std::string(name) + " must be a C-contiguous " + type + " array");
  }
  values.assign(array.data(), array.data() + array.size());
}

void make(LimbSeparator* self, nb::handle object, float onset, float softness, float pull, float damping, float blend,
          int steps, const Text& instruction_set) {
  CollisionShape s;
  const std::pair<const char*, std::vector<std::int32_t>*> integers[] = {
      {"parents", &s.parents},         {"dof_bone", &s.dof_bone},       {"trunk_bones", &s.trunk_bones},
      {"sphere_bone", &s.sphere_bone}, {"sphere_limb", &s.sphere_limb}, {"sphere_joints", &s.sphere_joints},
      {"capsules", &s.capsules},       {"groups", &s.groups},           {"pairs", &s.pairs},
      {"limb_start", &s.limb_start},   {"limb_dofs", &s.limb_dofs},     {"limb_kind", &s.limb_kind}};
  const std::pair<const char*, std::vector<float>*> floats[] = {{"heads", &s.heads},
                                                                {"dof_axis", &s.dof_axis},
                                                                {"dof_rest", &s.dof_rest},
                                                                {"dof_lower", &s.dof_lower},
                                                                {"dof_upper", &s.dof_upper},
                                                                {"trunk_heights", &s.trunk_heights},
                                                                {"trunk_frame", &s.trunk_frame},
                                                                {"trunk_coefficients", &s.trunk_coefficients},
                                                                {"sphere_centre", &s.sphere_centre},
                                                                {"sphere_radius", &s.sphere_radius},
                                                                {"group_reach", &s.group_reach},
                                                                {"allowed", &s.allowed}};
  for (const auto& [name, values] : integers) read(object, name, *values);
  for (const auto& [name, values] : floats) read(object, name, *values);
  const SeparationSettings settings{onset, softness, pull, damping, blend, steps};
  new (self) LimbSeparator(std::move(s), settings, select_kernels(instruction_set.value_or("")));
}

float separate(LimbSeparator& self, const Floats& joint_positions, const WrittenFloats& out) {
  check_shape(joint_positions, "joint_positions", {self.dofs()});
  check_shape(out, "out", {self.dofs()});
  float change = 0.0f;
  raise_if(self.separate(joint_positions.data(), out.data(), &change));
  return change;
}

}  // namespace

void bind_separation(nb::module_& module) {
  nb::class_<LimbSeparator>(module, "LimbSeparator")
      .def("__init__", &make, "shape"_a, "onset"_a, "softness"_a, "pull"_a, "damping"_a, "blend"_a, "steps"_a,
           "instruction_set"_a = nb::none())
      .def("separate", &separate, "joint_positions"_a.noconvert(), "out"_a.noconvert());
}

}  // namespace physkin

// The part of physkin_core._native that lets cloth swing: checks and converts, computes nothing.
#include "sway_binding.hpp"

#include <nanobind/ndarray.h>

#include "sway/pendulum.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace physkin {
namespace {

template <int kCount>
using Found = nb::ndarray<double, nb::shape<kCount>, nb::c_contig, nb::device::cpu>;
using Given = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

}  // namespace

void bind_sway(nb::module_& module) {
  nb::class_<Pendulum>(module, "Pendulum")
      .def(
          "__init__",
          [](Pendulum* self, double frequency, double damping, double gain, double lift_frequency, double lift_gain,
             double twist_damping, double air_drag) {
            new (self) Pendulum({frequency, damping, gain, lift_frequency, lift_gain, twist_damping, air_drag});
          },
          "frequency"_a, "damping"_a, "gain"_a, "lift_frequency"_a, "lift_gain"_a, "twist_damping"_a, "air_drag"_a)
      .def("reset", &Pendulum::reset)
      .def(
          "felt",
          [](Pendulum& self, double time, const Given& root, double amount, const Found<4>& out) {
            if (root.shape(0) != 7) throw nb::value_error("root must be 7 numbers: x, y, z and a quaternion x, y, z, w");
            if (const char* wrong = self.felt(time, root.data(), amount, out.data())) throw nb::value_error(wrong);
          },
          "time"_a, "root"_a, "amount"_a, "out"_a)
      .def(
          "motion", [](const Pendulum& self, const Found<6>& out) { return self.motion(out.data()); }, "out"_a);
}

}  // namespace physkin

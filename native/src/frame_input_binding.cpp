#include "frame_input_binding.hpp"

#include <cmath>

#include "bindings.hpp"
#include "numpy_arrays.hpp"
#include "python_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace physkin {
namespace {

using GivenVector = GivenNumbers<3>;

double seconds(nb::handle time) {
  const double value = PyFloat_AsDouble(time.ptr());
  if (value == -1 && PyErr_Occurred() != nullptr) throw nb::python_error();
  if (!std::isfinite(value))
    throw std::invalid_argument(std::string("time must be finite, got ") + nb::str(time).c_str());
  return value;
}

// Of a gravity of any length but zero.
struct UnitDirection {
  explicit UnitDirection(nb::handle gravity) {
    const GivenVector given(gravity);
    const long double x = given.data()[0], y = given.data()[1], z = given.data()[2];  // whose squares do not overflow
    const double length = given ? double(std::sqrt(x * x + y * y + z * z)) : 0.0;
    if (!(1e-9 <= length && std::isfinite(length))) given.raise("gravity must be a finite, non-zero direction (3,)");
    for (int axis = 0; axis < 3; ++axis) down[axis] = given.data()[axis] / length;
  }

  double down[3];
};

void hang(FrameInput& self, nb::handle gravity) {
  const GivenVector direction(gravity, "gravity");
  direction.raise_if(self.hang(direction.data()));
}

void accelerate(FrameInput& self, nb::handle effective_gravity, nb::handle at_rest) {
  const GivenVector felt(effective_gravity, "effective_gravity");
  if (at_rest.is_none()) {
    felt.raise_if(self.accelerate(felt.data(), nullptr));
  } else {
    felt.raise_if(self.accelerate(felt.data(), GivenVector(at_rest, "at_rest").data()));
  }
}

// Of a FrameInput or a RootTracker.
template <class Moved>
void move(Moved& self, nb::handle time, nb::handle root) {
  const double moment = seconds(time);
  const GivenNumbers<7> place(root, "root");
  place.raise_if(self.move(moment, place.data()));
}

void begin_frame(FrameInput& self, nb::handle time) {
  if (time.is_none()) {
    self.begin_still_frame();
  } else {
    raise_if(self.begin_frame(seconds(time)));
  }
}

void set_wind(FrameInput& self, nb::handle velocity) {
  const GivenVector wind(velocity, "wind");
  wind.raise_if(self.set_wind(wind.data()));
}

nb::ndarray<nb::numpy, float, nb::shape<-1, kGarmentInput>, nb::c_contig> rows(FrameInput& self) {
  return {
      reinterpret_cast<float*>(self.rows()), {std::size_t(self.count()), std::size_t(kGarmentInput)}, nb::find(self)};
}

}  // namespace

void fill(FrameInput& input, nb::handle gravity, nb::handle effective_gravity, nb::handle time, nb::handle root) {
  if (!root.is_none()) {
    if (time.is_none() || !effective_gravity.is_none()) {
      throw std::invalid_argument("give time with root, and no effective gravity: it follows from them");
    }
    move(input, time, root);
  } else if (!effective_gravity.is_none()) {
    accelerate(input, effective_gravity, nb::none());
  } else {
    input.hang(UnitDirection(gravity).down);
  }
  begin_frame(input, time);
}

void bind_frame_input(nb::module_& module) {
  Numpy::get();
  nb::class_<RootSample>(module, "RootSample").def_prop_ro("known", [](const RootSample& self) { return self.known; });
  nb::class_<RootTracker>(module, "RootTracker")
      .def(nb::init<>())
      .def("reset", &RootTracker::reset)
      .def(
          "move",
          [](RootTracker& self, nb::handle time, nb::handle root) {
            move(self, time, root);
            return self.sample();
          },
          "time"_a, "root"_a);
  nb::class_<FrameInput>(module, "FrameInput")
      .def(nb::init<int>(), "garments"_a)
      .def(
          "set_sway",
          [](FrameInput& self, int garment, double amount) {
            self.set_sway(checked_garment(garment, self.count()), amount);
          },
          "garment"_a, "amount"_a)
      .def(
          "sway", [](FrameInput& self, int garment) { return self.sway(checked_garment(garment, self.count())); },
          "garment"_a)
      .def("set_wind", set_wind, "velocity"_a)
      .def("wind",
           [](const FrameInput& self) { return nb::make_tuple(self.wind()[0], self.wind()[1], self.wind()[2]); })
      .def("reset", &FrameInput::reset)
      .def("hang", hang, "direction"_a)
      .def("accelerate", accelerate, "effective_gravity"_a, "at_rest"_a.none())
      .def("follow", &FrameInput::follow, "root"_a)
      .def("move", move<FrameInput>, "time"_a, "root"_a)
      .def("begin_frame", begin_frame, "time"_a.none())
      .def("fill", fill, "gravity"_a, "effective_gravity"_a.none(), "time"_a.none(), "root"_a.none())
      .def_prop_ro("rows", rows);
  module.def(
      "unit_direction",
      [](nb::handle gravity) {
        const UnitDirection unit(gravity);
        return nb::make_tuple(unit.down[0], unit.down[1], unit.down[2]);
      },
      "gravity"_a);
}

}  // namespace physkin

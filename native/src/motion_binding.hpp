#pragma once

#include <nanobind/nanobind.h>

namespace physkin {

// Adds `PoseSolver` to physkin_core._native.
void bind_motion(nanobind::module_& module);

}  // namespace physkin

#pragma once

#include <nanobind/nanobind.h>

namespace physkin {

// Adds `Pendulum` to physkin_core._native.
void bind_sway(nanobind::module_& module);

}  // namespace physkin

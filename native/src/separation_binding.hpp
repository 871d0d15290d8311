#pragma once

#include <nanobind/nanobind.h>

namespace physkin {

// Adds `LimbSeparator` to physkin_core._native.
void bind_separation(nanobind::module_& module);

}  // namespace physkin

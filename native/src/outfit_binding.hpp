#pragma once

#include <nanobind/nanobind.h>

namespace physkin {

// Adds `Outfit` and `OutfitStep` to physkin_core._native.
void bind_outfit(nanobind::module_& module);

}  // namespace physkin

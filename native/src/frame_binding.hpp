// The part of physkin_core._native that computes frames: their input, and garments evaluated.
#pragma once

#include <nanobind/nanobind.h>

namespace physkin {

void bind_frame(nanobind::module_& module);

}  // namespace physkin

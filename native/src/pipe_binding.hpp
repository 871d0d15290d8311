#pragma once

#include <nanobind/nanobind.h>

namespace physkin {

// Adds `read_pipe` to physkin_core._native.
void bind_pipe(nanobind::module_& module);

}  // namespace physkin

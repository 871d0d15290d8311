#pragma once

#include <nanobind/nanobind.h>

namespace physkin {

// Adds `MessageBeginning`, `JointReading` and `PoseRange` to physkin_core._native.
void bind_joints(nanobind::module_& module);

}  // namespace physkin

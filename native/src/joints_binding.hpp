#pragma once

#include <nanobind/nanobind.h>

namespace physkin {

// Adds `MessageBeginning`, `JointReading`, `PoseRange` and `PoseCheck` to physkin_core._native.
void bind_joints(nanobind::module_& module);

}  // namespace physkin

// The parts that binding.cpp puts together to physkin_core._native, each in a source of its own.
#pragma once

#include <nanobind/nanobind.h>

namespace physkin {

// `Evaluator`, `Step` and `LayerOrder`.
void bind_frame(nanobind::module_& module);
// What a frame is given: `RootSample`, `RootTracker`, `FrameInput` and `unit_direction`.
void bind_frame_input(nanobind::module_& module);
// `MessageBeginning`, `JointReading` and `PoseRange`.
void bind_joints(nanobind::module_& module);
// `LimbSeparator`.
void bind_separation(nanobind::module_& module);

}  // namespace physkin

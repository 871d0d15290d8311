// What Python gives a frame besides joint positions: checked and converted, for FrameInput.
#pragma once

#include <nanobind/nanobind.h>

#include "sway/frame_input.hpp"

namespace physkin {

// Says where down is and begins the frame, as FrameInput.fill of frame_input.py describes. Each may be None, gravity
// only where others take its place. Throws std::invalid_argument for what is refused.
void fill(FrameInput& input, nanobind::handle gravity, nanobind::handle effective_gravity, nanobind::handle time,
          nanobind::handle root);

}  // namespace physkin

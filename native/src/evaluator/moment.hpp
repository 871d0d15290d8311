// What a frame is told besides joint positions and gravity; as Moment of physkin_core/sway/moment.py.
#pragma once

#include <algorithm>
#include <optional>

namespace physkin {

// Of cloth that remembers the frame before. Its numbers come behind gravity in this order, none, the first two or all.
struct Moment {
  float twist = 0;                     // [rad] of what hangs round both legs, about the root's vertical
  float passed = -1;                   // [s] since the last frame, negative where that does not count
  float sway = 0;                      // how much of what LearntSway adds, 0: it forgets
  float elapsed = -1;                  // [s] the same, 0 where a stamp comes again, negative for a first frame
  float moves = 0;                     // whether rates of joints and root count, 0 or 1
  float velocity[3] = {}, turning[3] = {};  // [m/s], [rad/s] of the root since the last frame, in its frame of now
};

constexpr int kGravityAlone = 3, kGravityAndTwist = 5, kGravityAndMoment = 14;

// The moment behind a gravity of so many numbers, if there is one.
inline std::optional<Moment> moment_after(const float* gravity, int size) {
  if (size == kGravityAlone) return {};
  Moment moment;
  moment.twist = gravity[3];
  moment.passed = gravity[4];
  if (size == kGravityAndMoment) {
    moment.sway = gravity[5];
    moment.elapsed = gravity[6];
    moment.moves = gravity[7];
    std::copy_n(gravity + 8, 3, moment.velocity);
    std::copy_n(gravity + 11, 3, moment.turning);
  }
  return moment;
}

}  // namespace physkin

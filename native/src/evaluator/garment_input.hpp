// What a garment is given in a frame, besides joint positions.
#pragma once

namespace physkin {

// A row of kGarmentInput numbers for each garment; FrameInput fills it. Vectors are in the root frame. A drape by
// itself, which neither goes on from the frame before nor sways, has gravity alone, and all else as it is here.
struct GarmentInput {
  float gravity[3] = {0, 0, -1};  // effective gravity in units of gravity: 1 long for a root at rest
  float passed = -1;       // [s] since the last frame, by which cloth keeps its pace; negative: that does not count,
                           // and kStandsAlone: the next frame does not go on from this one either
  float sway = 0;          // how much of a sway network's offsets counts, to 1; at 0 it forgets what was before
  float elapsed = -1;      // [s] the same for the sway network: 0 where a stamp comes again, negative: a first frame
  float moves = 0;         // whether rates of joints and root count, 0 or 1; they do not after a gap or a jump
  float velocity[3] = {};  // [m/s] of the root since the last frame
  float turning[3] = {};   // [rad/s]
};

constexpr float kStandsAlone = -2;
constexpr int kGarmentInput = 13;
static_assert(sizeof(GarmentInput) == kGarmentInput * sizeof(float));

}  // namespace physkin

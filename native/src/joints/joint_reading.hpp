// Joint values of a message, read from its bytes as the joint positions of a rig; and how far these have gone.
#pragma once

#include <cstddef>
#include <vector>

namespace physkin {

// Joint `target` [rad] is scale * value `source` of the message + offset.
struct TakenJoint {
  int source, target;
  double scale, offset;
};

class JointReading {
 public:
  // first: where the message's values begin [bytes], any alignment; swapped: float64 of the other byte order. farthest:
  // [rad] a position beyond is not ordinary. Targets must be below `dofs`.
  JointReading(std::vector<TakenJoint> taken, std::size_t first, bool swapped, double farthest, std::size_t dofs);

  // Writes `start`, and over it the joints taken, into `out`, both of `dofs`. False, and `out` unchanged, when the
  // message is too short, or a position is not ordinary or not finite: then somebody has to look closer.
  bool read(const unsigned char* message, std::size_t size, const float* start, float* out);

 private:
  std::vector<TakenJoint> taken_;
  std::vector<float> positions_;
  std::size_t first_, end_;
  bool swapped_;
  float farthest_;
  std::size_t dofs_;
};

// Whether the first bytes of `message`, where `mask` is 0xff, are those of `pattern`, both of `count`.
bool begins_with(const unsigned char* message, std::size_t size, const unsigned char* pattern,
                 const unsigned char* mask, std::size_t count);

// Widens the range [least, most] of each of `count` joints by its position.
void widen(const float* positions, float* least, float* most, std::size_t count);

}  // namespace physkin

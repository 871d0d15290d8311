// Where cloth is from far places of its own. Included by kernel_unit.cpp only (see simd.hpp).
//
// Planes of samples near one are blended, those that face it as the sides of their blocks say: what presses opposes it,
// what was made over or beneath it faces as it does. Blocks are few and mostly apart, so their boxes are looked at first.
#pragma once

#include "kernels/contact_kernel.hpp"

namespace physkin::PHYSKIN_ISA {

// [m] So far from a sample others count for it; and the cosine from which one that faces it counts in full.
constexpr float kClothReach = 0.045f, kClothTurn = 0.5f;

inline void bound_cloth(const ClothBlocks& cloth) {
  const int samples = kBlock * cloth.count;
  for (int block = 0; block < cloth.count; ++block) {
    const std::int32_t* of_block = cloth.samples + kBlock * block;
    const ClothLanes lanes = as_lanes([&](int lane) { return cloth.rows + kSkinRow * of_block[lane]; });
    for (int c = 0; c < 6; ++c) {
      Floats low = lanes.of[c][0], high = low;
      for (int v = 0; v < kClothRegisters; ++v) {
        store(cloth.columns + c * samples + kBlock * block + v * kLanes, lanes.of[c][v]);
        low = smaller_of(low, lanes.of[c][v]);
        high = larger_of(high, lanes.of[c][v]);
      }
      if (c > 2) continue;
      cloth.boxes[c * cloth.rooms + block] = -largest_of(-low);
      cloth.boxes[(3 + c) * cloth.rooms + block] = largest_of(high);
    }
  }
}

inline bool meet_cloth(const ClothBlocks& cloth, int block, const std::int16_t* sides, float* planes) {
  const int samples = kBlock * cloth.count, rooms = cloth.rooms;
  ClothLanes own;
  for (int c = 0; c < 6; ++c) {
    for (int v = 0; v < kClothRegisters; ++v) {
      own.of[c][v] = load(cloth.columns + c * samples + kBlock * block + v * kLanes);
    }
  }
  float low[3], high[3];
  for (int c = 0; c < 3; ++c) {
    low[c] = cloth.boxes[c * rooms + block];
    high[c] = cloth.boxes[(3 + c) * rooms + block];
  }
  // Whether boxes, from their lowest places to their highest, are within reach.
  const auto near = [&](const float* lowest, const float* highest, int stride) {
    Floats square = {};
    for (int c = 0; c < 3; ++c) {
      const Floats beyond = larger_of(load(lowest + c * stride) - high[c], low[c] - load(highest + c * stride));
      const Floats apart = at_least(beyond, 0.0f);
      square += apart * apart;
    }
    return square < kClothReach * kClothReach;
  };
  int listed = 0;
  for (int first = 0; first < rooms; first += kLanes) {
    const float* boxes = cloth.boxes + first;
    unsigned blocks = bits_of(near(boxes, boxes + 3 * rooms, rooms) & (widened(sides + first) != 0.0f));
    for (; blocks != 0; blocks &= blocks - 1) {
      const int other = first + __builtin_ctz(blocks), begin = kBlock * other, side = sides[other];
      const float out = side > 1 ? -1.0f : 1.0f, faces = (side == 1 ? 1.0f : -1.0f) / kClothTurn;
      unsigned bits = 0;
      for (int v = 0; v < kClothRegisters; ++v) {
        const float* columns = cloth.columns + begin + v * kLanes;
        bits |= bits_of(near(columns, columns, samples)) << v * kLanes;
      }
      for (; bits != 0; bits &= bits - 1) {
        const float* row = cloth.rows + kSkinRow * cloth.samples[begin + __builtin_ctz(bits)];
        float* point = cloth.listed + kSkinRow * listed;
        Ints counts = {};
        for (int v = 0; v < kClothRegisters; ++v) counts |= square_from(own, v, row) < kClothReach * kClothReach;
        listed += any(counts);
        Quad place, normal;
        __builtin_memcpy(&place, row, sizeof place);
        __builtin_memcpy(&normal, row + 3, sizeof normal);
        normal = out * normal;
        normal[3] = faces;
        __builtin_memcpy(point, &place, sizeof place);
        __builtin_memcpy(point + 3, &normal, sizeof normal);
      }
    }
  }
  if (listed == 0) return false;
  bool lacks = false;
  for (int v = 0; v < kClothRegisters; ++v) {
    Floats shares = {}, off = {}, normal[3] = {};
    for (int k = 0; k < listed; ++k) {
      const float* point = cloth.listed + kSkinRow * k;
      const float nx = point[3], ny = point[4], nz = point[5];
      const Floats x = own.of[0][v] - point[0], y = own.of[1][v] - point[1], z = own.of[2][v] - point[2];
      const Floats root = at_least(1.0f - (x * x + y * y + z * z) * (1.0f / (kClothReach * kClothReach)), 0.0f);
      const Floats facing = point[6] * (nx * own.of[3][v] + ny * own.of[4][v] + nz * own.of[5][v]);
      const Floats share = root * root * at_most(at_least(facing, 0.0f), 1.0f);
      shares += share;
      off += share * (nx * x + ny * y + nz * z);
      normal[0] += share * nx;
      normal[1] += share * ny;
      normal[2] += share * nz;
    }
    const Floats away = off / larger_of(shares, Floats{} + 1e-9f);
    lacks |= any((shares > 0.0f) & (away < kFree));
    const Floats length = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2];
    const Floats inverse = reciprocal_sqrt(larger_of(length, Floats{} + 1e-30f));
    store(planes + v * kLanes, away);
    for (int c = 0; c < 3; ++c) store(planes + (c + 1) * kBlock + v * kLanes, normal[c] * inverse);
    store(planes + 4 * kBlock + v * kLanes, smaller_of(shares, Floats{} + 1.0f));
  }
  return lacks;
}

}  // namespace physkin::PHYSKIN_ISA

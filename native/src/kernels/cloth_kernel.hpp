// Where cloth is from far places of its own. Included by kernel_unit.cpp only (see simd.hpp).
//
// Planes of samples near one are blended, those that face it as the sides of their blocks say: what presses opposes it,
// what was made over or beneath it faces as it does. Blocks are few and mostly apart, so their spheres are looked at first.
#pragma once

#include "kernels/contact_kernel.hpp"

namespace physkin::PHYSKIN_ISA {

// [m] So far from a sample others count for it; and the cosine from which one that faces it counts in full.
constexpr float kClothReach = 0.045f, kClothTurn = 0.5f;

inline void bound_cloth(const ClothBlocks& cloth) {
  for (int block = 0; block < cloth.count; ++block) {
    Floats lanes[3][kClothRegisters], square = {};
    for (int v = 0; v < kClothRegisters; ++v) {
      Floats place[4];
      load_columns([&](int lane) { return cloth.rows + kSkinRow * (kBlock * block + v * kLanes + lane); }, place);
      for (int c = 0; c < 3; ++c) lanes[c][v] = place[c];
    }
    float* sphere = cloth.spheres + block;
    for (int c = 0; c < 3; ++c) {
      Floats sum = {};
      for (int v = 0; v < kClothRegisters; ++v) sum += lanes[c][v];
      sphere[c * cloth.rooms] = sum_of(sum) * (1.0f / kBlock);
    }
    for (int v = 0; v < kClothRegisters; ++v) {
      const Floats x = lanes[0][v] - sphere[0], y = lanes[1][v] - sphere[cloth.rooms];
      const Floats z = lanes[2][v] - sphere[2 * cloth.rooms];
      square = larger_of(square, x * x + y * y + z * z);
    }
    sphere[3 * cloth.rooms] = __builtin_sqrtf(largest_of(square));
  }
}

inline bool meet_cloth(const ClothBlocks& cloth, int block, const std::int16_t* sides, float* planes) {
  const float* sphere = cloth.spheres + block;
  const int rooms = cloth.rooms;
  const float middle[3] = {sphere[0], sphere[rooms], sphere[2 * rooms]}, within = sphere[3 * rooms] + kClothReach;
  int listed = 0;
  for (int first = 0; first < rooms; first += kLanes) {
    const Floats x = load(cloth.spheres + first) - middle[0], y = load(cloth.spheres + rooms + first) - middle[1];
    const Floats z = load(cloth.spheres + 2 * rooms + first) - middle[2];
    const Floats apart = load(cloth.spheres + 3 * rooms + first) + within;
    unsigned near = bits_of((x * x + y * y + z * z < apart * apart) & (widened(sides + first) != 0.0f));
    for (; near != 0; near &= near - 1) {
      const int other = first + __builtin_ctz(near);
      for (int v = 0; v < kClothRegisters; ++v) {
        Floats place[4];
        const int row = kBlock * other + v * kLanes;
        load_columns([&](int lane) { return cloth.rows + kSkinRow * (row + lane); }, place);
        const Floats px = place[0] - middle[0], py = place[1] - middle[1], pz = place[2] - middle[2];
        unsigned bits = bits_of(px * px + py * py + pz * pz < Floats{} + within * within);
        for (; bits != 0; bits &= bits - 1) cloth.listed[listed++] = row + __builtin_ctz(bits);
      }
    }
  }
  if (listed == 0) return false;
  const ClothLanes lanes = as_lanes(cloth.rows + kSkinRow * kBlock * block);
  Floats shares[kClothRegisters] = {}, off[kClothRegisters] = {}, normals[3][kClothRegisters] = {};
  for (int k = 0; k < listed; ++k) {
    const float* point = cloth.rows + kSkinRow * cloth.listed[k];
    const int side = sides[cloth.listed[k] / kBlock];
    const float faces = side < 0 ? -1.0f : 1.0f, out = side > 1 ? -1.0f : 1.0f;
    const float nx = out * point[3], ny = out * point[4], nz = out * point[5];
    const float fx = faces * point[3], fy = faces * point[4], fz = faces * point[5];
    for (int v = 0; v < kClothRegisters; ++v) {
      const Floats x = lanes.of[0][v] - point[0], y = lanes.of[1][v] - point[1], z = lanes.of[2][v] - point[2];
      const Floats facing = fx * lanes.of[3][v] + fy * lanes.of[4][v] + fz * lanes.of[5][v];
      const Floats root = larger_of(1.0f - (x * x + y * y + z * z) * (1.0f / (kClothReach * kClothReach)), Floats{});
      const Floats share = root * root * from_zero_to_one(facing * (1.0f / kClothTurn));
      shares[v] += share;
      off[v] += share * (nx * x + ny * y + nz * z);
      normals[0][v] += share * nx;
      normals[1][v] += share * ny;
      normals[2][v] += share * nz;
    }
  }
  for (int v = 0; v < kClothRegisters; ++v) {
    Floats length = {};
    for (int c = 0; c < 3; ++c) length += normals[c][v] * normals[c][v];
    const Floats inverse = reciprocal_sqrt(larger_of(length, Floats{} + 1e-30f));
    store(planes + v * kLanes, off[v] / larger_of(shares[v], Floats{} + 1e-9f));
    for (int c = 0; c < 3; ++c) store(planes + (c + 1) * kBlock + v * kLanes, normals[c][v] * inverse);
    store(planes + 4 * kBlock + v * kLanes, smaller_of(shares[v], Floats{} + 1.0f));
  }
  return true;
}

}  // namespace physkin::PHYSKIN_ISA

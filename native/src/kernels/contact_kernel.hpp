// Where cloth is from the skin: the facing rule. Included by kernel_unit.cpp only (see simd.hpp).
//
// Cloth is led to the side that its own outside is on. Skin beneath counts where its normal agrees with the cloth's, what
// presses on it where it opposes it; of what counts, the planes of the nearest points are blended.
#pragma once

#include "kernels/kernels.hpp"
#include "kernels/simd.hpp"

namespace physkin::PHYSKIN_ISA {

// [m] So deep cloth is still led out, fading over the last kFadeShare of it; and over which distance planes blend.
constexpr float kContactReach = 0.08f, kFadeShare = 0.3f, kContactBlend = 0.014f;
// Cosine from which skin counts in full, and how far below that it does not count.
constexpr float kFacing = 0.1f, kTurn = 0.5f;
// [m] Cloth in the skin is asked for less where it is farther than this beside points that count, and where it is farther
// by the second for nothing.
constexpr float kAside = 0.03f, kAsideFade = 0.02f;
// [m] Cloth that is so far off all skin that counts cannot lack anything.
constexpr float kFree = 0.015f;
// [m] A block of skin is looked at where its middle is no farther than this beyond that of the nearest one.
constexpr float kBeyond = 0.06f;

constexpr int kClothRegisters = kBlock / kLanes;

// As one instruction each.
inline Floats larger_of(Floats a, Floats b) { return a > b ? a : b; }
inline Floats smaller_of(Floats a, Floats b) { return a < b ? a : b; }
inline Floats from_zero_to_one(Floats v) { return smaller_of(larger_of(v, Floats{}), Floats{} + 1.0f); }
inline Floats square_root(Floats v) {
  const Floats positive = larger_of(v, Floats{} + 1e-12f);
  return positive * reciprocal_sqrt(positive);
}

inline float largest_of(Floats v) {
  float largest = v[0];
  for (int k = 1; k < kLanes; ++k) largest = v[k] > largest ? v[k] : largest;
  return largest;
}

inline float sum_of(Floats v) {
  float sum = v[0];
  for (int k = 1; k < kLanes; ++k) sum += v[k];
  return sum;
}

struct ClothLanes {
  Floats of[6][kClothRegisters];
};

// A block of cloth as a whole: a sphere around its samples, their mean normal, of unit length, and the cosine with that of
// a normal from which on none of them counts.
struct ClothBlock {
  float middle[3], normal[3], radius, turned;
};

inline ClothBlock as_a_whole(const ClothLanes& cloth) {
  ClothBlock whole;
  float normal[3];
  Floats square = {};
  for (int c = 0; c < 3; ++c) {
    Floats sum = {}, turned = {};
    for (int v = 0; v < kClothRegisters; ++v) {
      sum += cloth.of[c][v];
      turned += cloth.of[3 + c][v];
    }
    whole.middle[c] = sum_of(sum) * (1.0f / kBlock);
    normal[c] = sum_of(turned);
  }
  const float length = __builtin_sqrtf(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]);
  for (int c = 0; c < 3; ++c) whole.normal[c] = normal[c] / (length > 1e-6f ? length : 1e-6f);
  for (int v = 0; v < kClothRegisters; ++v) {
    const Floats x = cloth.of[0][v] - whole.middle[0], y = cloth.of[1][v] - whole.middle[1];
    const Floats z = cloth.of[2][v] - whole.middle[2];
    square = larger_of(square, x * x + y * y + z * z);
  }
  whole.radius = __builtin_sqrtf(largest_of(square));
  Floats least = Floats{} + 1.0f;
  for (int v = 0; v < kClothRegisters; ++v) {
    least = smaller_of(
        least, whole.normal[0] * cloth.of[3][v] + whole.normal[1] * cloth.of[4][v] + whole.normal[2] * cloth.of[5][v]);
  }
  // The sum of both angles' cosine; -1 where it is half a turn.
  const float spread = -largest_of(-least), limit = kFacing - kTurn;
  const float sines = (1.0f - spread * spread) * (1.0f - limit * limit);
  whole.turned = spread > -limit ? limit * spread - __builtin_sqrtf(sines > 0.0f ? sines : 0.0f) : -1.0f;
  return whole;
}

// Lists blocks of skin that face a block of cloth within reach. Their number; 0 where the cloth is off all of them.
inline int blocks_near(const SkinBlocks& skin, const std::int16_t* sides, const ClothBlock& cloth,
                       std::int32_t* blocks) {
  int count = 0;
  bool free = true;
  for (int first = 0; first < skin.count; first += kLanes) {
    const Floats side = widened(sides + first);
    if (!any(side != 0.0f)) continue;
    const float* middle = skin.middles + 6 * kBlock * (first / kBlock) + first % kBlock;
    const Floats x = cloth.middle[0] - load(middle), y = cloth.middle[1] - load(middle + kBlock);
    const Floats z = cloth.middle[2] - load(middle + 2 * kBlock);
    const Floats within = larger_of(load(skin.radii + first) + (cloth.radius + kContactReach), Floats{});
    const Ints reached = x * x + y * y + z * z < within * within;
    if (!any(reached)) continue;
    const Floats nx = load(middle + 3 * kBlock), ny = load(middle + 4 * kBlock), nz = load(middle + 5 * kBlock);
    const Floats facing = side * (nx * cloth.normal[0] + ny * cloth.normal[1] + nz * cloth.normal[2]);
    const Ints near = reached & (facing > cloth.turned);
    free &= !any(near & (nx * x + ny * y + nz * z < cloth.radius + kFree));
    for (unsigned bits = bits_of(near & (side != 0.0f)); bits != 0; bits &= bits - 1) {
      blocks[count++] = first + __builtin_ctz(bits);
    }
  }
  return free ? 0 : count;
}

// How far samples are turned away from a block of skin, from 0, where it counts in full, to 1, where it does not.
inline Floats turned_away(const float* middle, float side, const ClothLanes& cloth, int v) {
  const Floats facing = side * (middle[3 * kBlock] * cloth.of[3][v] + middle[4 * kBlock] * cloth.of[4][v] +
                                middle[5 * kBlock] * cloth.of[5][v]);
  const Floats away = from_zero_to_one((kFacing - facing) * (1.0f / kTurn));
  return away * away * (3.0f - 2.0f * away);
}

inline const float* points_of(const SkinBlocks& skin, int block) {
  return skin.points + 6 * kBlock * (block / 2) + kSkinBlock * (block % 2);
}

inline Floats square_from(const ClothLanes& cloth, int v, const float* point) {
  const Floats x = cloth.of[0][v] - point[0], y = cloth.of[1][v] - point[kBlock];
  const Floats z = cloth.of[2][v] - point[2 * kBlock];
  return x * x + y * y + z * z;
}

// Leaves those of the listed blocks that are nearly the nearest of a sample, and what each adds to squared distances as
// samples are turned away, (left, kBlock) into `turned`. Their number.
inline int nearest_blocks(const SkinBlocks& skin, const std::int16_t* sides, const ClothLanes& cloth, int count,
                          const ContactRoom& room) {
  Floats nearest[kClothRegisters];
  for (int v = 0; v < kClothRegisters; ++v) nearest[v] = Floats{} + 1.0f;
  for (int k = 0; k < count; ++k) {
    const int block = room.blocks[k];
    const float* middle = skin.middles + 6 * kBlock * (block / kBlock) + block % kBlock;
    const float side = sides[block];
    for (int v = 0; v < kClothRegisters; ++v) {
      const Floats turned = (kContactReach * kContactReach) * turned_away(middle, side, cloth, v);
      const Floats square = square_from(cloth, v, middle) + turned;
      store(room.turned + k * kBlock + v * kLanes, turned);
      store(room.squares + k * kBlock + v * kLanes, square);
      nearest[v] = smaller_of(nearest[v], square);
    }
  }
  for (int v = 0; v < kClothRegisters; ++v) {
    const Floats within = square_root(nearest[v]) + kBeyond;
    nearest[v] = within * within;
  }
  int left = 0;
  for (int k = 0; k < count; ++k) {
    Ints counts = {};
    for (int v = 0; v < kClothRegisters; ++v) {
      counts |= load(room.squares + k * kBlock + v * kLanes) < nearest[v];
      store(room.turned + left * kBlock + v * kLanes, load(room.turned + k * kBlock + v * kLanes));
    }
    room.blocks[left] = room.blocks[k];
    left += any(counts);
  }
  return left;
}

inline bool meet_skin(const SkinBlocks& skin, const float* cloth_columns, const std::int16_t* sides,
                      const ContactRoom& room, float* planes) {
  constexpr float kFar = kContactReach * kContactReach;
  ClothLanes cloth;
  for (int c = 0; c < 6; ++c) {
    for (int v = 0; v < kClothRegisters; ++v) cloth.of[c][v] = load(cloth_columns + c * kBlock + v * kLanes);
  }
  const int listed = blocks_near(skin, sides, as_a_whole(cloth), room.blocks);
  if (listed == 0) return false;
  const int count = nearest_blocks(skin, sides, cloth, listed, room);

  for (int v = 0; v < kClothRegisters; ++v) {
    Floats least = Floats{} + kFar;
    float* squares = room.squares;
    for (int k = 0; k < count; ++k) {
      const float* point = points_of(skin, room.blocks[k]);
      float* of_block = room.turned + k * kBlock + v * kLanes;
      const Floats turned = load(of_block);
      Floats nearest = Floats{} + kFar;
      for (int i = 0; i < kSkinBlock; ++i, ++point, squares += kLanes) {
        const Floats square = square_from(cloth, v, point) + turned;
        store(squares, square);
        nearest = smaller_of(nearest, square);
      }
      store(of_block, nearest);
      least = smaller_of(least, nearest);
    }

    const Floats within = kContactBlend * kContactBlend + 0.2f * least, per = 1.0f / within;
    Floats shares = {}, off = {}, apart = {}, normal[3] = {};
    for (int k = 0; k < count; ++k) {
      if (!any(load(room.turned + k * kBlock + v * kLanes) - least < within)) continue;
      const float* point = points_of(skin, room.blocks[k]);
      squares = room.squares + k * kSkinBlock * kLanes;
      for (int i = 0; i < kSkinBlock; ++i, ++point, squares += kLanes) {
        const Floats near = 1.0f - (load(squares) - least) * per;
        if (!any(near > 0.0f)) continue;
        const Floats positive = larger_of(near, Floats{}), share = positive * positive;
        const Floats x = cloth.of[0][v] - point[0], y = cloth.of[1][v] - point[kBlock];
        const Floats z = cloth.of[2][v] - point[2 * kBlock];
        const float nx = point[3 * kBlock], ny = point[4 * kBlock], nz = point[5 * kBlock];
        shares += share;
        off += share * (nx * x + ny * y + nz * z);
        apart += share * (x * x + y * y + z * z);
        normal[0] += share * nx;
        normal[1] += share * ny;
        normal[2] += share * nz;
      }
    }
    const Floats per_share = 1.0f / larger_of(shares, Floats{} + 1e-9f), away = off * per_share;
    const Floats length = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2];
    const Floats inverse = reciprocal_sqrt(larger_of(length, Floats{} + 1e-30f));
    const Floats fade = (kContactReach - square_root(least)) * (1.0f / (kFadeShare * kContactReach));
    const Floats beside = square_root(apart * per_share - away * away);
    const Floats held = from_zero_to_one((kAside + kAsideFade - beside) * (1.0f / kAsideFade));
    store(planes + v * kLanes, away);
    for (int c = 0; c < 3; ++c) store(planes + (c + 1) * kBlock + v * kLanes, normal[c] * inverse);
    const Floats deep = from_zero_to_one(fade) * (away < 0.0f ? held : Floats{} + 1.0f);
    store(planes + 4 * kBlock + v * kLanes, (least < kFar) & (shares > 0.0f) ? deep : Floats{});
  }
  return true;
}

}  // namespace physkin::PHYSKIN_ISA

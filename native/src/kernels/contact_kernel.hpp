// Where cloth is from the skin: the facing rule. Included by kernel_unit.cpp only (see simd.hpp).
//
// Cloth is led to the side that its own outside is on. Skin beneath counts where its normal agrees with the cloth's, what
// presses on it where it opposes it; of what counts, the planes of the nearest points are blended.
#pragma once

#include "kernels/fours.hpp"
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
  return reduced(v, [](Quad a, Quad b) { return a > b ? a : b; });
}
inline float sum_of(Floats v) {
  return reduced(v, [](Quad a, Quad b) { return a + b; });
}

struct ClothLanes {
  Floats of[6][kClothRegisters];
};

template <class RowOf>
ClothLanes as_lanes(RowOf row_of) {
  ClothLanes cloth;
  for (int v = 0; v < kClothRegisters; ++v) {
    const auto row = [&](int lane) { return row_of(v * kLanes + lane); };
    Floats place[4], normal[4];
    load_columns(row, place);
    load_columns([&](int lane) { return row(lane) + 2; }, normal);
    for (int c = 0; c < 3; ++c) {
      cloth.of[c][v] = place[c];
      cloth.of[3 + c][v] = normal[c + 1];
    }
  }
  return cloth;
}

// A block of cloth as a whole: a sphere around its samples, their mean normal, of unit length, and the cosines with that of
// skin that counts for none of them, and from which on it counts in full for all.
struct ClothBlock {
  float middle[3], normal[3], radius, turned, full;
};

// Cosine of the sum of two angles, or of their difference, from their cosines.
inline float cosine_of(float first, float second, float sign) {
  const float sines = (1.0f - first * first) * (1.0f - second * second);
  return first * second - sign * __builtin_sqrtf(sines > 0.0f ? sines : 0.0f);
}

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
  const float spread = -largest_of(-least), limit = kFacing - kTurn;
  whole.turned = spread > -limit ? cosine_of(spread, limit, 1) : -1.0f;  // -1: their sum is half a turn
  whole.full = spread > kFacing ? cosine_of(spread, kFacing, -1) : 2.0f;
  return whole;
}

// Blocks of skin are listed, and what is asked of each, without branches: what is near is hard to foresee.

// Lists blocks of skin that face a block of cloth within reach: first those that count in full, then the others.
struct NearBlocks {
  int full = 0, count = 0;
  bool free = true;  // the cloth is off all of them
};

// Appends the places of bits.
inline int list_bits(const std::uint64_t* words, int count, std::int32_t* places, int listed) {
  for (int k = 0; k < count; ++k) {
    for (std::uint64_t bits = words[k]; bits != 0; bits &= bits - 1) places[listed++] = 64 * k + __builtin_ctzll(bits);
  }
  return listed;
}

inline NearBlocks blocks_near(const SkinBlocks& skin, const std::int16_t* sides, const ClothBlock& cloth,
                              const ContactRoom& room) {
  const int words = (skin.count + 63) / 64;
  std::uint64_t *full = room.bits, *others = room.bits + words;
  Ints near_plane = {};
  for (int word = 0; word < words; ++word) {
    const int end = 64 * word + 64 < skin.count ? 64 * word + 64 : skin.count;
    std::uint64_t in_word[2] = {};
    for (int first = 64 * word; first < end; first += kLanes) {
      const Floats side = widened(sides + first);
      const auto column = [&](int c) { return load(skin.columns + c * skin.count + first); };
      const Floats x = cloth.middle[0] - column(0), y = cloth.middle[1] - column(1), z = cloth.middle[2] - column(2);
      const Floats nx = column(3), ny = column(4), nz = column(5);
      const Floats within = larger_of(load(skin.radii + first) + (cloth.radius + kContactReach), Floats{});
      const Floats facing = side * (nx * cloth.normal[0] + ny * cloth.normal[1] + nz * cloth.normal[2]);
      const Ints near = (x * x + y * y + z * z < within * within) & (facing > cloth.turned) & (side != 0.0f);
      const Ints in_full = near & (facing > cloth.full);
      near_plane |= near & (nx * x + ny * y + nz * z < cloth.radius + kFree);
      in_word[0] |= std::uint64_t(bits_of(in_full)) << first % 64;
      in_word[1] |= std::uint64_t(bits_of(near & ~in_full)) << first % 64;
    }
    full[word] = in_word[0];
    others[word] = in_word[1];
  }
  NearBlocks found;
  found.free = !any(near_plane);
  if (found.free) return found;
  found.full = list_bits(full, words, room.blocks, 0);
  found.count = list_bits(others, words, room.blocks, found.full);
  return found;
}

// How far samples are turned away from a block of skin, from 0, where it counts in full, to 1, where it does not.
inline Floats turned_away(const float* middle, float side, const ClothLanes& cloth, int v) {
  const Floats facing = side * (middle[3] * cloth.of[3][v] + middle[4] * cloth.of[4][v] + middle[5] * cloth.of[5][v]);
  const Floats away = from_zero_to_one((kFacing - facing) * (1.0f / kTurn));
  return away * away * (3.0f - 2.0f * away);
}

inline Floats square_from(const ClothLanes& cloth, int v, const float* point) {
  const Floats x = cloth.of[0][v] - point[0], y = cloth.of[1][v] - point[1], z = cloth.of[2][v] - point[2];
  return x * x + y * y + z * z;
}

// Leaves those of the listed blocks that are nearly the nearest of a sample, and what each adds to squared distances as
// samples are turned away, (left, kBlock) into `turned`. Their number.
inline int nearest_blocks(const SkinBlocks& skin, const std::int16_t* sides, const ClothLanes& cloth, NearBlocks near,
                          const ContactRoom& room) {
  Floats nearest[kClothRegisters];
  for (int v = 0; v < kClothRegisters; ++v) nearest[v] = Floats{} + 1.0f;
  const auto look = [&](int k, auto turned_of) {
    const int block = room.blocks[k];
    const float* middle = skin.middles + kSkinRow * block;
    for (int v = 0; v < kClothRegisters; ++v) {
      const Floats turned = turned_of(middle, block, v), square = square_from(cloth, v, middle) + turned;
      store(room.turned + k * kBlock + v * kLanes, turned);
      store(room.squares + k * kBlock + v * kLanes, square);
      nearest[v] = smaller_of(nearest[v], square);
    }
  };
  for (int k = 0; k < near.full; ++k) look(k, [](const float*, int, int) { return Floats{}; });
  for (int k = near.full; k < near.count; ++k) {
    look(k, [&](const float* middle, int block, int v) {
      return (kContactReach * kContactReach) * turned_away(middle, sides[block], cloth, v);
    });
  }
  for (int v = 0; v < kClothRegisters; ++v) {
    const Floats within = square_root(nearest[v]) + kBeyond;
    nearest[v] = within * within;
  }
  int left = 0;
  for (int k = 0; k < near.count; ++k) {
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

inline bool meet_skin(const SkinBlocks& skin, const float* cloth_rows, const std::int16_t* sides,
                      const ContactRoom& room, float* planes) {
  constexpr float kFar = kContactReach * kContactReach;
  const ClothLanes cloth = as_lanes([&](int lane) { return cloth_rows + kSkinRow * lane; });
  const NearBlocks near = blocks_near(skin, sides, as_a_whole(cloth), room);
  if (near.free) return false;
  const int count = nearest_blocks(skin, sides, cloth, near, room);

  Floats at[3][kClothRegisters], leasts[kClothRegisters];  // of its own, so that stores do not have it loaded again
  for (int v = 0; v < kClothRegisters; ++v) {
    for (int c = 0; c < 3; ++c) at[c][v] = cloth.of[c][v];
    leasts[v] = Floats{} + kFar;
  }
  float* squares = room.squares;
  for (int k = 0; k < count; ++k) {
    const float* point = skin.points + kSkinRow * kSkinBlock * room.blocks[k];
    float* of_block = room.turned + k * kBlock;
    Floats turned[kClothRegisters], nearest[kClothRegisters];
    for (int v = 0; v < kClothRegisters; ++v) {
      turned[v] = load(of_block + v * kLanes);
      nearest[v] = Floats{} + kFar;
    }
#pragma GCC unroll 8
    for (int i = 0; i < kSkinBlock; ++i, point += kSkinRow, squares += kBlock) {
      for (int v = 0; v < kClothRegisters; ++v) {
        const Floats x = at[0][v] - point[0], y = at[1][v] - point[1], z = at[2][v] - point[2];
        const Floats square = x * x + y * y + z * z + turned[v];
        store(squares + v * kLanes, square);
        nearest[v] = smaller_of(nearest[v], square);
      }
    }
    for (int v = 0; v < kClothRegisters; ++v) {
      store(of_block + v * kLanes, nearest[v]);
      leasts[v] = smaller_of(leasts[v], nearest[v]);
    }
  }

  for (int v = 0; v < kClothRegisters; ++v) {
    const Floats least = leasts[v], within = kContactBlend * kContactBlend + 0.2f * least, per = 1.0f / within;
    const Floats most = least + within;
    int blocks = 0, points = 0;
    for (int k = 0; k < count; ++k) {
      room.listed[blocks] = k;
      blocks += any(load(room.turned + k * kBlock + v * kLanes) < most);
    }
    std::int32_t* blending = room.listed + blocks;
    for (int b = 0; b < blocks; ++b) {
      const int first = kSkinBlock * room.listed[b];
      const float* of_block = room.squares + first * kBlock + v * kLanes;
#pragma GCC unroll 8
      for (int i = 0; i < kSkinBlock; ++i) {
        blending[points] = first + i;
        points += any(load(of_block + i * kBlock) < most);
      }
    }
    Floats shares = {}, off = {}, apart = {}, normal[3] = {};
    for (int k = 0; k < points; ++k) {
      const unsigned at = unsigned(blending[k]), of_block = unsigned(room.blocks[at / kSkinBlock]);
      const float* point = skin.points + kSkinRow * (kSkinBlock * of_block + at % kSkinBlock);
      const Floats square = load(room.squares + at * kBlock + v * kLanes);
      const Floats root = larger_of(1.0f - (square - least) * per, Floats{}), share = root * root;
      const Floats x = cloth.of[0][v] - point[0], y = cloth.of[1][v] - point[1], z = cloth.of[2][v] - point[2];
      const float nx = point[3], ny = point[4], nz = point[5];
      shares += share;
      off += share * (nx * x + ny * y + nz * z);
      apart += share * (x * x + y * y + z * z);
      normal[0] += share * nx;
      normal[1] += share * ny;
      normal[2] += share * nz;
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
    store(planes + 4 * kBlock + v * kLanes, ((least < kFar) & (shares > 0.0f)) ? deep : Floats{});
  }
  return true;
}

}  // namespace physkin::PHYSKIN_ISA

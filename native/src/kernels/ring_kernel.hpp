// Normals of vertices from the faces around them. Included by kernel_unit.cpp only (see simd.hpp).
#pragma once

#if defined(__AVX2__)
#include <immintrin.h>
#endif

#include "kernels/fours.hpp"
#include "kernels/kernels.hpp"
#include "kernels/simd.hpp"

namespace physkin::PHYSKIN_ISA {

// Vertices in a register, a four each.
constexpr int kFours = kLanes / 4;
static_assert(kRingGroup % kLanes == 0);

// [m2] Less than any face: what a ring without an area has upwards.
constexpr float kUpwards = 1e-18f;

// Of kFours vertices.
template <class Index>
inline Floats places_at(const float* places, const Index* at) {
  const auto one = [places](Index place) { return places + 2 * std::size_t(place); };
#if defined(__AVX2__)
  const auto two = [one](const Index* from) {
    return _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_load_ps(one(from[0]))), _mm_load_ps(one(from[1])), 1);
  };
#endif
#if defined(__AVX512F__)
  // Zeros where the mask has none, which is nowhere: the instruction without a mask has GCC 12 warn of its own header.
  return (Floats)_mm512_maskz_insertf64x4(0xff, _mm512_castpd256_pd512((__m256d)two(at)), (__m256d)two(at + 2), 1);
#elif defined(__AVX2__)
  return (Floats)two(at);
#else
  return load(one(at[0]));
#endif
}

// In every four: 1, 2, 0, 3. A cross product is turned(a * turned(b) - turned(a) * b).
inline Floats turned(Floats v) { return turned_fours<1, 2, 0, 3>(v); }

// Twice the areas within the rings of kFours vertices, not turned yet. They are the sum of cross products of neighbours
// that follow each other, or of every other one with the step between the two beside it; and from any point, such as the
// first neighbour, whose product then vanishes.
template <class Index>
inline Floats ring_areas(const float* places, const Index* ring, int length) {
  const Floats corner = places_at(places, ring);
  Floats before = places_at(places, ring + kRingGroup);
  Floats area = shuffle_fours<kLanes, 0, 0, 0>(Floats{}, Floats{} + kUpwards);
#pragma GCC unroll 4
  for (int k = 2; k < length; k += 2) {
    const Floats between = places_at(places, ring + k * kRingGroup) - corner;
    const Floats after = places_at(places, ring + (k + 1) * kRingGroup), across = after - before;
    area += between * turned(across);
    area -= turned(between) * across;
    before = after;
  }
  return area;
}

template <int kFour, class Index>
inline void write_row(Floats yz_and_x, const float* place, const Index* vertex, const VertexRows& rows,
                      std::ptrdiff_t row_bytes) {
  const Quad normal = four_lanes<kFour>(yz_and_x), own = *reinterpret_cast<const Quad*>(place + 4 * kFour);
  const Quad first = __builtin_shufflevector(own, normal, 0, 1, 2, 7);
  unsigned char* row = rows.data + vertex[kFour] * row_bytes;
  __builtin_memcpy(row, &first, sizeof first);
  __builtin_memcpy(row + sizeof first, &normal, 2 * sizeof(float));
}

// Of kLanes vertices, kFours in each register.
template <class Index>
inline void write_normals(const Floats* areas, const float* place, const Index* vertex, const VertexRows& rows,
                          std::ptrdiff_t row_bytes) {
  Floats square[4];
  for (int k = 0; k < 4; ++k) square[k] = areas[k] * areas[k];
  const Floats low = zip_low(square[0], square[1]), low_next = zip_low(square[2], square[3]);
  const Floats high = zip_high(square[0], square[1]), high_next = zip_high(square[2], square[3]);
  const Floats inverse =
      inverse_length(halves_low(low, low_next) + halves_high(low, low_next) + halves_low(high, high_next));
  const Floats of_each[4] = {turned_fours<0, 0, 0, 0>(inverse), turned_fours<1, 1, 1, 1>(inverse),
                             turned_fours<2, 2, 2, 2>(inverse), turned_fours<3, 3, 3, 3>(inverse)};
  for (int k = 0; k < 4; ++k, place += 4 * kFours, vertex += kFours) {
    const Floats unit = areas[k] * of_each[k];
    const Floats yz_and_x = turned_fours<2, 0, 3, 1>(unit);  // turned, and x where a place has nothing
    write_row<0>(yz_and_x, place, vertex, rows, row_bytes);
#if defined(__AVX2__)
    write_row<1>(yz_and_x, place, vertex, rows, row_bytes);
#endif
#if defined(__AVX512F__)
    write_row<2>(yz_and_x, place, vertex, rows, row_bytes);
    write_row<3>(yz_and_x, place, vertex, rows, row_bytes);
#endif
  }
}

// kLength: of the rings, or 0 to take it from `length`.
template <int kLength, class Index>
inline void write_group(const FaceRings& rings, const RingIndices<Index>& indices, int group, int length,
                        const VertexRows& rows, std::ptrdiff_t row_bytes) {
  const Index* ring = indices.neighbour + std::ptrdiff_t(rings.start[group]) * kRingGroup;
  const std::ptrdiff_t first = std::ptrdiff_t(group) * kRingGroup;
  for (int lane = 0; lane < kRingGroup; lane += kLanes) {
    Floats areas[4];
#pragma GCC unroll 4
    for (int k = 0; k < 4; ++k) {
      areas[k] = ring_areas(rings.places, ring + lane + k * kFours, kLength > 0 ? kLength : length);
    }
    write_normals(areas, rings.places + 4 * (first + lane), indices.vertex + first + lane, rows, row_bytes);
  }
}

template <class Index>
inline void write_groups(const FaceRings& rings, const RingIndices<Index>& indices, const VertexRows& rows) {
  const std::ptrdiff_t row_bytes = rows.stride * std::ptrdiff_t(sizeof(float));
  for (int group = 0; group < rings.group_count; ++group) {
    const int length = rings.start[group + 1] - rings.start[group];
    if (length == 6) {  // most of a mesh
      write_group<6>(rings, indices, group, length, rows, row_bytes);
    } else {
      write_group<0>(rings, indices, group, length, rows, row_bytes);
    }
  }
}

// Copies, as rows are bytes, which what they are written from could be, too.
inline void ring_normals(FaceRings rings, VertexRows rows) {
  rings.narrow.vertex != nullptr ? write_groups(rings, rings.narrow, rows) : write_groups(rings, rings.wide, rows);
}

}  // namespace physkin::PHYSKIN_ISA

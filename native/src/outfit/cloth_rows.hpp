// Cloth rows in registers of four floats: one point in a register, or a number of each of four points.
#pragma once

#include <cstdint>
#include <cstring>

#include "kernels/kernels.hpp"

namespace physkin {

typedef float Quad __attribute__((vector_size(16)));
typedef std::int32_t QuadInts __attribute__((vector_size(16)));

inline Quad smaller(Quad a, Quad b) { return a < b ? a : b; }
inline Quad larger(Quad a, Quad b) { return a > b ? a : b; }
inline Quad clamp01(Quad v) { return smaller(larger(v, Quad{}), Quad{} + 1.0f); }

// Of four points, the sum of each one's first three numbers.
inline Quad sums_of_three(Quad a, Quad b, Quad c, Quad d) {
  const Quad low_ab = __builtin_shufflevector(a, b, 0, 4, 1, 5), low_cd = __builtin_shufflevector(c, d, 0, 4, 1, 5);
  const Quad high_ab = __builtin_shufflevector(a, b, 2, 6, 3, 7), high_cd = __builtin_shufflevector(c, d, 2, 6, 3, 7);
  return __builtin_shufflevector(low_ab, low_cd, 0, 1, 4, 5) + __builtin_shufflevector(low_ab, low_cd, 2, 3, 6, 7) +
         __builtin_shufflevector(high_ab, high_cd, 0, 1, 4, 5);
}

// Of four points, all first numbers in one register, all second ones in the next, and so on.
struct Transposed {
  Quad first, second, third, fourth;
};

inline Transposed transposed(Quad a, Quad b, Quad c, Quad d) {
  const Quad low_ab = __builtin_shufflevector(a, b, 0, 4, 1, 5), low_cd = __builtin_shufflevector(c, d, 0, 4, 1, 5);
  const Quad high_ab = __builtin_shufflevector(a, b, 2, 6, 3, 7), high_cd = __builtin_shufflevector(c, d, 2, 6, 3, 7);
  return {__builtin_shufflevector(low_ab, low_cd, 0, 1, 4, 5), __builtin_shufflevector(low_ab, low_cd, 2, 3, 6, 7),
          __builtin_shufflevector(high_ab, high_cd, 0, 1, 4, 5), __builtin_shufflevector(high_ab, high_cd, 2, 3, 6, 7)};
}

inline Quad sums(Quad a, Quad b, Quad c, Quad d) {
  const Transposed t = transposed(a, b, c, d);
  return (t.first + t.second) + (t.third + t.fourth);
}

// Rows x y z nx ny nz, of no alignment. Four floats from the start of a row, and from its third on, stay within the
// row.
struct ClothRows {
  explicit ClothRows(const VertexRows& rows) : data(rows.data), stride(rows.stride * std::ptrdiff_t(sizeof(float))) {}

  Quad position(std::int32_t vertex) const { return load(data + vertex * stride); }  // x y z nx
  Quad normal(std::int32_t vertex) const {                                           // nx ny nz z
    const Quad v = load(data + vertex * stride + 2 * sizeof(float));
    return __builtin_shufflevector(v, v, 1, 2, 3, 0);
  }
  void move(std::int32_t vertex, float along_normal) const {
    const Quad before = position(vertex), after = before + along_normal * normal(vertex);
    const Quad row = __builtin_shufflevector(after, before, 0, 1, 2, 7);
    std::memcpy(data + vertex * stride, &row, sizeof row);
  }

  static Quad load(const unsigned char* at) {
    Quad v;
    std::memcpy(&v, at, sizeof v);
    return v;
  }

  unsigned char* data;
  std::ptrdiff_t stride;
};

// Four rows, number by number.
struct FourRows {
  FourRows(const ClothRows& rows, const std::int32_t* four) {
    const Transposed a =
        transposed(rows.position(four[0]), rows.position(four[1]), rows.position(four[2]), rows.position(four[3]));
    const Transposed b =
        transposed(rows.normal(four[0]), rows.normal(four[1]), rows.normal(four[2]), rows.normal(four[3]));
    x = a.first, y = a.second, z = a.third, nx = a.fourth, ny = b.second, nz = b.third;
  }

  Quad x, y, z, nx, ny, nz;
};

// How far four points are outside planes, and the squares of how far they are along these.
struct OffPlanes {
  Quad off, aside_square;
};

inline OffPlanes off_planes(const Quad* gap, const Quad* normal) {
  const Quad off = sums_of_three(gap[0] * normal[0], gap[1] * normal[1], gap[2] * normal[2], gap[3] * normal[3]);
  const Quad square = sums_of_three(gap[0] * gap[0], gap[1] * gap[1], gap[2] * gap[2], gap[3] * gap[3]);
  return {off, square - off * off};
}

}  // namespace physkin

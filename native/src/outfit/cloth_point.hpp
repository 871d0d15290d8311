// Cloth where it lies in its rows: x y z nx ny nz, of no alignment.
#pragma once

#include <cstring>

#include "evaluator/affine.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

struct ClothPoint {
  Vector3 position, normal;
};

inline ClothPoint load_point(const VertexRows& rows, std::int32_t vertex) {
  ClothPoint point;
  static_assert(sizeof point == 6 * sizeof(float));
  std::memcpy(&point, rows.data + vertex * rows.stride * std::ptrdiff_t(sizeof(float)), sizeof point);
  return point;
}

inline Vector3 load_position(const VertexRows& rows, std::int32_t vertex) {
  Vector3 position;
  std::memcpy(&position, rows.data + vertex * rows.stride * std::ptrdiff_t(sizeof(float)), sizeof position);
  return position;
}

inline void store_position(const VertexRows& rows, std::int32_t vertex, Vector3 position) {
  std::memcpy(rows.data + vertex * rows.stride * std::ptrdiff_t(sizeof(float)), &position, sizeof position);
}

}  // namespace physkin

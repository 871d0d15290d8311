// Small fixed-size matrices for bones and garment nodes, row-major.
#pragma once

#include <algorithm>
#include <cmath>

namespace physkin {

struct Vector3 {
  float x, y, z;
};

inline Vector3 operator+(Vector3 a, Vector3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vector3 operator-(Vector3 a, Vector3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vector3 operator*(float s, Vector3 a) { return {s * a.x, s * a.y, s * a.z}; }
inline float dot(Vector3 a, Vector3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vector3 cross(Vector3 a, Vector3 b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
// The zero vector stays zero, so that a degenerate rotation collapses a garment node but never makes a NaN.
inline Vector3 normalized(Vector3 a) { return (1.0f / std::sqrt(std::max(dot(a, a), 1e-30f))) * a; }

inline Vector3 load_vector(const float* p) { return {p[0], p[1], p[2]}; }

struct Matrix3 {
  Vector3 rows[3];
};

constexpr Matrix3 kIdentity3{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};

inline Matrix3 from_columns(Vector3 a, Vector3 b, Vector3 c) {
  return {{{a.x, b.x, c.x}, {a.y, b.y, c.y}, {a.z, b.z, c.z}}};
}
inline Vector3 operator*(const Matrix3& m, Vector3 v) {
  return {dot(m.rows[0], v), dot(m.rows[1], v), dot(m.rows[2], v)};
}
inline Matrix3 operator*(const Matrix3& a, const Matrix3& b) {
  Matrix3 product;
  for (int i = 0; i < 3; ++i) {
    const Vector3 row = a.rows[i];
    product.rows[i] = row.x * b.rows[0] + row.y * b.rows[1] + row.z * b.rows[2];
  }
  return product;
}

// Rotation about a unit axis (Rodrigues).
inline Matrix3 rotation(Vector3 axis, float angle) {
  const float s = std::sin(angle), c = std::cos(angle);
  const Vector3 t = (1.0f - c) * axis;
  return {{{t.x * axis.x + c, t.x * axis.y - s * axis.z, t.x * axis.z + s * axis.y},
           {t.y * axis.x + s * axis.z, t.y * axis.y + c, t.y * axis.z - s * axis.x},
           {t.z * axis.x - s * axis.y, t.z * axis.y + s * axis.x, t.z * axis.z + c}}};
}

// x -> linear x + translation; stored in arrays as (3, 4), row-major [linear | translation].
struct Affine {
  Matrix3 linear;
  Vector3 translation;
};

inline Affine load_affine(const float* p) {
  return {{{load_vector(p), load_vector(p + 4), load_vector(p + 8)}}, {p[3], p[7], p[11]}};
}
inline void store_affine(const Affine& a, float* p) {
  const float translation[3] = {a.translation.x, a.translation.y, a.translation.z};
  for (int i = 0; i < 3; ++i, p += 4) {
    p[0] = a.linear.rows[i].x;
    p[1] = a.linear.rows[i].y;
    p[2] = a.linear.rows[i].z;
    p[3] = translation[i];
  }
}

}  // namespace physkin

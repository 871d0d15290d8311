// Small fixed-size matrices and a blend for bones and garment nodes, row-major; single precision where not said otherwise.
#pragma once

#include <algorithm>
#include <cmath>

namespace physkin {

// From 0 to 1 as u does, and level at both ends.
inline float smooth_step(float u) {
  u = std::clamp(u, 0.0f, 1.0f);
  return u * u * (3 - 2 * u);
}

// How far to move what lacks so much, or each of several numbers: it sets in without a kink and, from twice `soft` on, leaves
// `soft`. Nothing is below zero.
template <class Real>
Real soft_push(Real lacks, float soft) {
  return lacks < 2.0f * soft ? lacks * lacks / (4.0f * soft) : lacks - soft;
}

template <class Real>
struct Vector3Of {
  Real x, y, z;
};
using Vector3 = Vector3Of<float>;

template <class Real>
Vector3Of<Real> operator+(Vector3Of<Real> a, Vector3Of<Real> b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class Real>
Vector3Of<Real> operator-(Vector3Of<Real> a, Vector3Of<Real> b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class Real>
Vector3Of<Real> operator*(Real s, Vector3Of<Real> a) {
  return {s * a.x, s * a.y, s * a.z};
}
template <class Real>
Real dot(Vector3Of<Real> a, Vector3Of<Real> b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
inline Vector3 cross(Vector3 a, Vector3 b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
// The zero vector stays zero, so that a degenerate rotation collapses a garment node but never makes a NaN.
inline Vector3 normalized(Vector3 a) { return (1.0f / std::sqrt(std::max(dot(a, a), 1e-30f))) * a; }

template <class Real>
Vector3Of<Real> load_vector(const Real* p) {
  return {p[0], p[1], p[2]};
}

template <class Real>
struct Matrix3Of {
  Vector3Of<Real> rows[3];
};
using Matrix3 = Matrix3Of<float>;

template <class Real>
constexpr Matrix3Of<Real> kIdentity3Of{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
constexpr Matrix3 kIdentity3 = kIdentity3Of<float>;

inline Matrix3 from_columns(Vector3 a, Vector3 b, Vector3 c) {
  return {{{a.x, b.x, c.x}, {a.y, b.y, c.y}, {a.z, b.z, c.z}}};
}
template <class Real>
Vector3Of<Real> operator*(const Matrix3Of<Real>& m, Vector3Of<Real> v) {
  return {dot(m.rows[0], v), dot(m.rows[1], v), dot(m.rows[2], v)};
}
template <class Real>
Matrix3Of<Real> operator*(const Matrix3Of<Real>& a, const Matrix3Of<Real>& b) {
  Matrix3Of<Real> product;
  for (int i = 0; i < 3; ++i) {
    const Vector3Of<Real> row = a.rows[i];
    product.rows[i] = row.x * b.rows[0] + row.y * b.rows[1] + row.z * b.rows[2];
  }
  return product;
}

// Rotation about a unit axis (Rodrigues).
template <class Real>
Matrix3Of<Real> rotation(Vector3Of<Real> axis, Real angle) {
  const Real s = std::sin(angle), c = std::cos(angle);
  const Vector3Of<Real> t = (Real(1) - c) * axis;
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

#include "evaluator/face_normals.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>
#include <stdexcept>
#include <vector>

namespace physkin {
namespace {

typedef float Quad __attribute__((vector_size(16)));

constexpr float kSmallestSquare = 1e-30f;  // m4: of a triangle with sides of 50 nm

// Four floats from anywhere; a row that holds a normal has six.
inline Quad load_quad(const void* at) {
  Quad v;
  std::memcpy(&v, at, sizeof v);
  return v;
}

inline Quad turned(Quad v) { return __builtin_shufflevector(v, v, 1, 2, 0, 3); }

inline Quad cross(Quad a, Quad b) { return turned(a * turned(b) - turned(a) * b); }

}  // namespace

FaceNormals::FaceNormals(const BoundGarment& g, Arena& arena)
    : vertex_count_(g.vertex_count), face_count_(g.face_count) {
  if (g.face_count == 0) throw std::invalid_argument("normals of faces need a garment with faces; this one has none");
  const std::size_t corner_count = 3 * std::size_t(g.face_count);
  std::vector<std::vector<std::int32_t>> faces_of(g.vertex_count);
  for (std::size_t c = 0; c < corner_count; ++c) faces_of[g.faces[c]].push_back(std::int32_t(c / 3));
  std::vector<std::int32_t> order(g.vertex_count), first{0}, faces;
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return faces_of[a].size() < faces_of[b].size(); });
  for (const std::int32_t v : order) {
    faces.insert(faces.end(), faces_of[v].begin(), faces_of[v].end());
    first.push_back(std::int32_t(faces.size()));
  }
  corners_ = arena.copy(g.faces, corner_count);
  vertex_ = arena.copy(order.data(), order.size());
  first_face_ = arena.copy(first.data(), first.size());
  face_ = arena.copy(faces.data(), faces.size());
  cross_ = arena.take<float>(4 * std::size_t(g.face_count));
}

void FaceNormals::apply(const VertexRows& rows) const noexcept {
  const std::ptrdiff_t stride = rows.stride * std::ptrdiff_t(sizeof(float));
  for (int face = 0; face < face_count_; ++face) {
    const std::int32_t* corner = corners_ + 3 * std::ptrdiff_t(face);
    const Quad a = load_quad(rows.data + corner[0] * stride);
    const Quad ab = load_quad(rows.data + corner[1] * stride) - a, ac = load_quad(rows.data + corner[2] * stride) - a;
    const Quad normal = cross(ab, ac);
    std::memcpy(cross_ + 4 * std::ptrdiff_t(face), &normal, sizeof normal);
  }
  for (int k = 0; k < vertex_count_; ++k) {
    Quad sum = {};
    for (std::int32_t at = first_face_[k]; at < first_face_[k + 1]; ++at) {
      sum += load_quad(cross_ + 4 * std::ptrdiff_t(face_[at]));
    }
    const float square = sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2];
    const Quad unit = square < kSmallestSquare ? Quad{0, 0, 1, 0} : sum / std::sqrt(square);
    std::memcpy(rows.data + vertex_[k] * stride + 3 * sizeof(float), &unit, 3 * sizeof(float));
  }
}

}  // namespace physkin

// Vertex normals from the posed mesh: where the cloth ripples they differ by degrees from skinned rest normals.
#pragma once

#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

class FaceNormals {
 public:
  // Throws std::invalid_argument if the garment has no faces.
  FaceNormals(const SkinningData& garment, const Kernels& kernels, Arena& arena);

  // Where positions have to be put before, of each vertex into row place_of(vertex); `place` copies them from rows.
  VertexRows places() const noexcept { return {reinterpret_cast<unsigned char*>(rings_.places), 4, false, true}; }
  int place_of(int vertex) const noexcept { return place_of_[vertex]; }
  void place(const VertexRows& rows) noexcept;

  // Writes positions that were placed, and unit normals weighted by the faces' areas. A vertex whose faces have no area,
  // or that has none, gets +Z.
  void write(const VertexRows& rows) const noexcept { kernels_.ring_normals(rings_, rows); }

 private:
  const Kernels& kernels_;
  int vertex_count_;
  const std::int32_t* place_of_;  // (vertex_count_,)
  FaceRings rings_;
};

}  // namespace physkin

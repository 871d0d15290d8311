// Vertex normals from the posed mesh: where the cloth ripples they differ by degrees from skinned rest normals.
#pragma once

#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

class FaceNormals {
 public:
  // Throws std::invalid_argument if the garment has no faces.
  FaceNormals(const BoundGarment& garment, Arena& arena);

  // Writes unit normals, weighted by the faces' areas, beside the positions in `rows`, which must have room for them.
  // A vertex whose faces have no area, or that has none, gets +Z.
  void apply(const VertexRows& rows) const noexcept;

 private:
  int vertex_count_, face_count_;
  const std::int32_t* corners_;  // (face_count, 3)
  const std::int32_t* vertex_;   // (vertex_count,) by their number of faces, so that the processor foresees loops' ends
  const std::int32_t* first_face_;  // (vertex_count + 1,) into the next, in the order of vertex_
  const std::int32_t* face_;        // faces by vertex, in their order
  float* cross_;                    // (face_count, 4) normals of twice the area's length, and an unused number
};

}  // namespace physkin

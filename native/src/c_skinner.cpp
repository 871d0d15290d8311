// Of include/physkin.h, what poses no garment itself: skinning by garment nodes that come from elsewhere.
#include <algorithm>
#include <iterator>
#include <memory>
#include <string>

#include "c_interface.hpp"
#include "kernels/arena.hpp"

using physkin::c_interface::fail;

namespace {

const std::int32_t* indices(const std::uint32_t* given) { return reinterpret_cast<const std::int32_t*>(given); }

physkin::SkinningData skinning_data(const physkin_mesh& mesh) {
  for (const std::int32_t count : {mesh.vertex_count, mesh.face_count, mesh.node_count, mesh.influences,
                                   mesh.detail_node_count, mesh.detail_influences}) {
    if (count < 0)
      throw std::invalid_argument("a count of the mesh is " + std::to_string(count) + "; none is negative");
  }
  const bool detail = mesh.detail_node_count > 0;
  const void* always[] = {mesh.rest_vertices, mesh.rest_normals, mesh.node_rest, mesh.influence_nodes,
                          mesh.influence_weights};
  const void* of_detail[] = {mesh.detail_nodes, mesh.detail_weights};
  if (std::count(std::begin(always), std::end(always), nullptr) > 0 || (mesh.face_count > 0 && mesh.faces == nullptr) ||
      (detail && std::count(std::begin(of_detail), std::end(of_detail), nullptr) > 0)) {
    throw std::invalid_argument("an array of the mesh is null");
  }
  physkin::SkinningData data;
  data.nodes = mesh.node_count;
  data.vertex_count = mesh.vertex_count;
  data.influences = mesh.influences;
  data.face_count = mesh.face_count;
  data.node_rest = mesh.node_rest;
  data.vertices = mesh.rest_vertices;
  data.normals = mesh.rest_normals;
  data.influence_nodes = indices(mesh.influence_nodes);
  data.influence_weights = mesh.influence_weights;
  data.faces = indices(mesh.faces);
  data.detail_vertices = detail ? mesh.vertex_count : 0;
  data.detail_influences = mesh.detail_influences;
  data.detail_numbers = physkin::numbers_of_detail(mesh.detail_node_count);
  data.detail_nodes = indices(mesh.detail_nodes);
  data.detail_weights = mesh.detail_weights;
  validate(data);
  return data;
}

}  // namespace

struct physkin_skinner {
  physkin_skinner(const physkin::SkinningData& data, const physkin::c_interface::Wanted& how)
      : skinner(data, *how.kernels, arena) {}

  physkin::Arena arena;
  physkin::Skinner skinner;
};

extern "C" {

physkin_status physkin_skinner_open(const physkin_mesh* mesh, const physkin_options* options,
                                    physkin_skinner** skinner) {
  if (mesh == nullptr || skinner == nullptr) return fail(PHYSKIN_BAD_ARGUMENT, "%s", "mesh or skinner is null");
  *skinner = nullptr;
  if (mesh->size < sizeof *mesh) {
    return fail(PHYSKIN_BAD_ARGUMENT, "mesh.size is %u; set it to sizeof(physkin_mesh)", unsigned(mesh->size));
  }
  return physkin::c_interface::guarded([&] {
    const physkin::c_interface::Wanted how(options);
    *skinner = std::make_unique<physkin_skinner>(skinning_data(*mesh), how).release();
    return PHYSKIN_OK;
  });
}

void physkin_skinner_close(physkin_skinner* skinner) { delete skinner; }

physkin_status physkin_skin(physkin_skinner* skinner, const float* transforms, const float* detail_offsets, float* out,
                            int32_t columns, ptrdiff_t stride) {
  if (skinner == nullptr || transforms == nullptr || out == nullptr) {
    return fail(PHYSKIN_BAD_ARGUMENT, "%s", "skinner, transforms or out is null");
  }
  physkin::Skinner& by = skinner->skinner;
  if (by.detail_nodes() > 0 && detail_offsets == nullptr) {
    return fail(PHYSKIN_BAD_ARGUMENT, "%s", "detail_offsets is null");
  }
  if (const physkin_status status = physkin::c_interface::check_rows(columns, stride)) return status;
  physkin::Rejection bad = by.check(transforms);
  if (!bad) bad = by.check_offsets(detail_offsets);
  if (bad) return fail(bad);
  const physkin::VertexRows rows{reinterpret_cast<unsigned char*>(out), stride, columns == 6};
  by.skin(transforms, detail_offsets, rows);
  by.compute_normals(rows);
  return PHYSKIN_OK;
}

}  // extern "C"

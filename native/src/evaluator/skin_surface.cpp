#include "evaluator/skin_surface.hpp"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "evaluator/affine.hpp"
#include "evaluator/skinner.hpp"

namespace physkin {
namespace {

// Points of a block turn about their joints each by themselves: it may grow by this share, and this [m].
constexpr float kGrows = 1.2f, kStretches = 0.005f;

SkinningData as_vertices(const BoundGarment& g) {
  SkinningData data;
  data.nodes = g.bones;
  data.vertex_count = g.skin_points;
  data.influences = g.skin_influences;
  data.vertices = g.skin_positions;
  data.normals = g.skin_normals;
  data.influence_nodes = g.skin_bones;
  data.influence_weights = g.skin_weights;
  return data;
}

// A block of points as one, with the bones of all.
struct Middle {
  Vector3 at{0, 0, 0}, normal{0, 0, 0};
  float radius = 0;
};

Middle middle_of(const BoundGarment& g, int block) {
  Middle middle;
  const auto point = [&](int k) { return load_vector(g.skin_positions + 3 * (kSkinBlock * block + k)); };
  for (int k = 0; k < kSkinBlock; ++k) {
    middle.at = middle.at + (1.0f / kSkinBlock) * point(k);
    middle.normal = middle.normal + load_vector(g.skin_normals + 3 * (kSkinBlock * block + k));
  }
  middle.normal = normalized(middle.normal);
  for (int k = 0; k < kSkinBlock; ++k) {
    const Vector3 away = point(k) - middle.at;
    middle.radius = std::max(middle.radius, kGrows * std::sqrt(dot(away, away)) + kStretches);
  }
  return middle;
}

}  // namespace

SkinSurface::SkinSurface(const BoundGarment& g, const Kernels& kernels, Arena& arena)
    : kernels_(kernels), points_(pack_skinning_blocks(as_vertices(g), arena, BlockOrder::kAsGiven)) {
  const int blocks = g.skin_points / kSkinBlock, rooms = SkinSurface::rooms(g);
  const int each = kSkinBlock * g.skin_influences;
  std::vector<float> at, normals, weights(std::size_t(blocks * each));
  float* radii = arena.take<float>(std::size_t(rooms));
  std::fill_n(radii, rooms, -1e3f);  // blocks that are not there are near nothing
  for (int block = 0; block < blocks; ++block) {
    const Middle middle = middle_of(g, block);
    at.insert(at.end(), {middle.at.x, middle.at.y, middle.at.z});
    normals.insert(normals.end(), {middle.normal.x, middle.normal.y, middle.normal.z});
    radii[block] = middle.radius;
  }
  std::transform(g.skin_weights, g.skin_weights + blocks * each, weights.begin(),
                 [](float weight) { return weight / kSkinBlock; });
  SkinningData middles = as_vertices(g);
  middles.vertex_count = blocks;
  middles.influences = each;
  middles.vertices = at.data();
  middles.normals = normals.data();
  middles.influence_weights = weights.data();
  middles_ = pack_skinning_blocks(middles, arena, BlockOrder::kAsGiven);
  points_rows_ = arena.take<float>(std::size_t(kSkinRow * kSkinBlock * rooms));
  middle_rows_ = arena.take<float>(std::size_t(kSkinRow * rooms));
  columns_ = arena.take<float>(6 * std::size_t(rooms));
  posed_ = {rooms, points_rows_, middle_rows_, columns_, radii};
}

void SkinSurface::pose(const float* bone_transforms) noexcept {
  for (const auto& [blocks, rows] : {std::pair(&points_, points_rows_), std::pair(&middles_, middle_rows_)}) {
    kernels_.skin(*blocks, bone_transforms, nullptr, {reinterpret_cast<unsigned char*>(rows), kSkinRow, true});
  }
  for (int block = 0; block < middles_.vertex_count; ++block) {
    for (int c = 0; c < 6; ++c) columns_[c * posed_.count + block] = middle_rows_[kSkinRow * block + c];
  }
}

}  // namespace physkin

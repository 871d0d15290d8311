#include "evaluator/skin_part.hpp"

#include <algorithm>
#include <cmath>

namespace physkin {
namespace {

// Along a part's axis: where its bones begin, and where the last one ends.
float height_of(const TrunkField& field, int bone) {
  return bone == 0 ? field.low : bone == field.bones ? field.high : field.heights[bone];
}

// [m] The largest radius between two heights, by the splines that reach there, in some directions.
float widest(const TrunkField& field, float from, float to) {
  constexpr int kDirections = 32;
  const float scale = float(field.splines - 2) / (field.high - field.low), most_cells = float(field.splines - 2);
  const auto cell = [&](float height) { return int(std::clamp((height - field.low) * scale, 0.0f, most_cells)); };
  const int first = cell(from), last = std::max(first, std::min(cell(to) + 2, field.splines - 1));
  float most = 0;
  for (int spline = first; spline <= last; ++spline) {
    const float* waves = field.coefficients + kTrunkWaves * spline;
    for (int k = 0; k < kDirections; ++k) {
      float radius = waves[0];
      for (int h = 1; 2 * h < kTrunkWaves; ++h) {
        const float angle = 6.2831853f * float(h * k) / kDirections;
        radius += waves[2 * h - 1] * std::cos(angle) + waves[2 * h] * std::sin(angle);
      }
      most = std::max(most, radius);
    }
  }
  return most;
}

}  // namespace

SkinPart::SkinPart(const BoundGarment& g, int part, Arena& arena)
    : bones(arena.copy(g.skin_bones + kSkinBones * part, kSkinBones)),
      frame(arena.copy(g.skin_frames + 12 * part, 12)),
      back(arena.take<float>(12 * kSkinBones)),
      presses(g.skin_presses[part] != 0) {
  const std::size_t coefficients = std::size_t(g.skin_splines) * kTrunkWaves;
  const float* shape = g.skin_shapes + 5 * part;
  const float* heights = arena.copy(g.skin_heights + kSkinBones * part, kSkinBones);
  const float* waves = arena.copy(g.skin_coefficients + coefficients * part, coefficients);
  field = {1, g.skin_splines, shape[0], shape[1], shape[2], shape[3], shape[4], back, heights, waves};
  while (field.bones < kSkinBones && heights[field.bones] < kNoHeight) ++field.bones;
  for (int bone = 0; bone < field.bones; ++bone) {
    widths[bone] = widest(field, height_of(field, bone), height_of(field, bone + 1));
  }
}

void SkinPart::pose(const float* bone_transforms) noexcept {
  const Affine to_own = load_affine(frame);
  for (int k = 0; k < field.bones; ++k) {
    const Affine bone = load_affine(bone_transforms + 12 * bones[k]);
    const Matrix3 turn = to_own.linear * from_columns(bone.linear.rows[0], bone.linear.rows[1], bone.linear.rows[2]);
    store_affine({turn, to_own.translation - turn * bone.translation}, back + 12 * k);
  }
  for (int k = 0; k <= field.bones; ++k) {
    const Affine turn = load_affine(back + 12 * std::min(k, field.bones - 1));
    const Vector3 from = Vector3{field.x, field.y, height_of(field, k)} - turn.translation;
    const Vector3 at = from.x * turn.linear.rows[0] + from.y * turn.linear.rows[1] + from.z * turn.linear.rows[2];
    const float posed[] = {at.x, at.y, at.z};
    std::copy_n(posed, 3, axis + 3 * k);
  }
}

std::vector<SkinPart> skin_parts(const BoundGarment& garment, Arena& arena) {
  std::vector<SkinPart> parts;
  for (int k = 0; k < garment.skin_parts; ++k) parts.emplace_back(garment, k, arena);
  return parts;
}

}  // namespace physkin

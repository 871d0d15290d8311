#include "push_out.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <string>
#include <vector>

#include "affine.hpp"
#include "finite.hpp"
#include "skinning_blocks.hpp"

namespace physkin {
namespace {

// Metres; their meaning is explained where the reference states them (physkin_core/push_out.py).
constexpr float kClearance = 0.001f;
constexpr float kSoftness = 0.0015f;
constexpr float kLookCloser = 0.003f;
constexpr float kTrustedDepth = 0.025f;
constexpr float kLargestDepth = 0.05f;
constexpr float kToleratedDepth = 0.0005f;
constexpr float kBesideBegins = 0.6f, kBesideEnds = 0.85f;
constexpr float kNearEnough = 0.002f;
constexpr int kRounds = 2;
constexpr int kAhead = 6;  // patches under way

constexpr float kLargest = 1e6f;

void check_finite(const char* name, const float* values, std::size_t count) {
  const std::size_t bad = first_beyond(values, count, kLargest);
  if (bad < count) {
    throw std::invalid_argument(std::string(name) + "[" + std::to_string(bad) + "] (flattened) is " +
                                std::to_string(values[bad]) + "; must be finite and within +-1e6");
  }
}

void check_index(const char* name, const std::int32_t* values, std::size_t count, int lowest, int limit) {
  for (std::size_t i = 0; i < count; ++i) {
    if (values[i] < lowest || values[i] >= limit) {
      throw std::invalid_argument(std::string(name) + "[" + std::to_string(i) + "] (flattened) is " +
                                  std::to_string(values[i]) + "; must be in [" + std::to_string(lowest) + ", " +
                                  std::to_string(limit) + ")");
    }
  }
}

void validate(const BoundPushOut& b, int bones, int garment_vertices) {
  if (b.candidate_count > b.body_count) throw std::invalid_argument("push-out has more candidates than body vertices");
  check_finite("body_vertices", b.body_vertices, 3 * std::size_t(b.body_count));
  check_finite("body_normals", b.body_normals, 3 * std::size_t(b.body_count));
  check_finite("body_weights", b.body_weights, std::size_t(b.body_count) * b.influences);
  check_finite("body_bend", b.body_bend, b.candidate_count);
  check_index("body_bones", b.body_bones, std::size_t(b.body_count) * b.influences, 0, bones);
  check_index("body_patch", b.body_patch, std::size_t(b.candidate_count) * kPatch * 3, 0, b.body_count);
  check_index("block_vertices", b.block_vertices, std::size_t(b.block_count) * kBlock, -1, garment_vertices);
  check_index("candidates", b.candidates, b.listed_count, 0, b.candidate_count);
  if (b.candidate_start[0] != 0 || b.candidate_start[b.block_count] != b.listed_count ||
      !std::is_sorted(b.candidate_start, b.candidate_start + b.block_count + 1)) {
    throw std::invalid_argument("candidate_start must ascend from 0 to the number of candidates, " +
                                std::to_string(b.listed_count));
  }
  for (int block = 0; block < b.block_count; ++block) {
    const int count = b.candidate_start[block + 1] - b.candidate_start[block];
    if (count > kMaxCandidates) {
      throw std::invalid_argument("candidate_start gives block " + std::to_string(block) + " " + std::to_string(count) +
                                  " candidates; at most " + std::to_string(kMaxCandidates) + " are allowed");
    }
  }
}

float smooth_step(float t) { return t * t * (3 - 2 * t); }

// Twin of `displacement` in the reference: how far outwards a vertex at a signed distance has to go.
float displacement(float distance) {
  const float below = kClearance + kSoftness - distance;
  const float in_band = std::clamp(below, 0.0f, 2 * kSoftness);
  const float push = in_band * in_band / (4 * kSoftness) + std::max(below - 2 * kSoftness, 0.0f);
  const float fade = std::clamp((distance + kLargestDepth) / (kLargestDepth - kTrustedDepth), 0.0f, 1.0f);
  return push * smooth_step(fade);
}

struct Contact {
  float distance;  // negative inside
  Vector3 normal;  // unit, mixed from the corners'
  float trust;     // 0 where the point lies beside the patch rather than in or over it, 1 where it does not
};

Contact contact(const Kernels& kernels, const std::int32_t* patch, const float* posed, Vector3 at) {
  const float point[3] = {at.x, at.y, at.z};
  const PatchPoint found = kernels.closest_on_patch(patch, posed, point);
  const float weights[3] = {1 - found.second - found.third, found.second, found.third};
  Vector3 closest{0, 0, 0}, normal{0, 0, 0};
  for (int k = 0; k < 3; ++k) {
    const float* corner = posed + std::ptrdiff_t(patch[3 * found.triangle + k]) * kBodyRow;
    closest = closest + weights[k] * load_vector(corner);
    normal = normal + weights[k] * load_vector(corner + 3);
  }
  const Vector3 offset = at - closest, unit = normalized(normal);
  const float length = std::sqrt(dot(offset, offset)), along = dot(offset, unit);
  const Vector3 sideways = offset - along * unit;
  const float beside = std::sqrt(dot(sideways, sideways)) / std::max(length, kNearEnough);
  const float trust = std::clamp((kBesideEnds - beside) / (kBesideEnds - kBesideBegins), 0.0f, 1.0f);
  return {std::copysign(length, along), unit, smooth_step(trust)};
}

}  // namespace

PushOut::PushOut(const BoundPushOut& b, int bones, int garment_vertices, Arena& arena) {
  validate(b, bones, garment_vertices);
  BoundGarment body;  // as far as skinning it goes, a body is a garment whose nodes are bones
  body.nodes = bones;
  body.vertex_count = b.body_count;
  body.influences = b.influences;
  body.vertices = b.body_vertices;
  body.normals = b.body_normals;
  body.influence_nodes = b.body_bones;
  body.influence_weights = b.body_weights;
  body_ = pack_skinning_blocks(body, arena);

  auto* vertex = arena.take<std::int32_t>(std::size_t(b.block_count) * kBlock);
  auto* count = arena.take<std::int32_t>(b.block_count);
  for (int block = 0; block < b.block_count; ++block) {
    const std::int32_t* given = b.block_vertices + std::size_t(block) * kBlock;
    count[block] = std::int32_t(std::find(given, given + kBlock, -1) - given);
    if (count[block] == 0) throw std::invalid_argument("a block of the push-out has no vertices");
    for (int lane = 0; lane < kBlock; ++lane) vertex[block * kBlock + lane] = given[lane < count[block] ? lane : 0];
  }
  std::vector<std::int32_t> start{0}, candidates;
  for (int block = 0; block < b.block_count; ++block) {
    candidates.insert(candidates.end(), b.candidates + b.candidate_start[block],
                      b.candidates + b.candidate_start[block + 1]);
    if (candidates.size() % 2 != 0) candidates.push_back(candidates.back());
    start.push_back(std::int32_t(candidates.size()));
  }
  blocks_ = {b.block_count, vertex, count, arena.copy(start.data(), start.size()),
             arena.copy(candidates.data(), candidates.size())};
  patches_ = arena.copy(b.body_patch, std::size_t(b.candidate_count) * kPatch * 3);
  posed_ = arena.take<float>(std::size_t(b.body_count) * kBodyRow);
  for (int i = 0; i < b.candidate_count; ++i) posed_[std::size_t(i) * kBodyRow + 6] = b.body_bend[i];
  near_ = arena.take<NearVertex>(std::size_t(b.block_count) * kBlock);
}

ContactResidual PushOut::apply(const Kernels& kernels, const float* bone_transforms,
                               const VertexRows& rows) noexcept {
  kernels.skin(body_, bone_transforms, {reinterpret_cast<unsigned char*>(posed_), kBodyRow, true});
  const int count = kernels.find_near(blocks_, posed_, rows, kLookCloser, near_);
  ContactResidual residual;
  for (int i = 0; i < count; ++i) {
    if (i + kAhead < count) {  // the patches are too many to stay in a near cache, and their order is not foreseeable
      const std::int32_t* soon = patches_ + std::size_t(near_[i + kAhead].candidate) * kPatch * 3;
      __builtin_prefetch(soon);
      __builtin_prefetch(soon + 3 * kPatch - 1);
    }
    const std::int32_t* patch = patches_ + std::size_t(near_[i].candidate) * kPatch * 3;
    unsigned char* row = rows.data + near_[i].vertex * rows.stride * std::ptrdiff_t(sizeof(float));
    float values[6];
    const std::size_t bytes = (rows.with_normals ? 6 : 3) * sizeof(float);
    std::memcpy(values, row, bytes);

    const Vector3 before = load_vector(values);
    Vector3 at = before;
    Contact now = contact(kernels, patch, posed_, at);
    bool moved = false;
    for (int round = 0; round < kRounds; ++round) {
      const float push = now.trust * displacement(now.distance);
      if (push == 0.0f) break;
      at = at + push * now.normal;
      now = contact(kernels, patch, posed_, at);
      moved = true;
    }
    if (now.trust > 0.5f && now.distance > -kLargestDepth) {
      residual.deepest = std::max(residual.deepest, -now.distance);
      residual.left_inside += now.distance < -kToleratedDepth;
    }
    if (!moved) continue;
    const Vector3 way = at - before;
    const float turn = std::sqrt(dot(way, way)) / kLookCloser;
    std::memcpy(values, &at, sizeof at);
    if (rows.with_normals) {
      const Vector3 normal = normalized(load_vector(values + 3) + turn * now.normal);
      std::memcpy(values + 3, &normal, sizeof normal);
    }
    std::memcpy(row, values, bytes);
  }
  return residual;
}

}  // namespace physkin

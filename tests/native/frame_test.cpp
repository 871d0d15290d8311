// The evaluator as a C++ library, without Python: counts what a frame allocates, on garments of odd sizes, alone and
// two together, which must give the same bits.
//
// Prints "<instruction set> <precision> <allocations>" for each garment. All buffers have their exact size,
// so that a build with the address sanitizer finds a kernel that reads or writes beyond them.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <random>
#include <vector>

#include "evaluator/evaluator.hpp"
#include "kernels/dispatch.hpp"
#include "sway/frame_input.hpp"

static long allocations = 0;

#if defined(__has_feature)
#if __has_feature(address_sanitizer)
#define __SANITIZE_ADDRESS__  // as GCC says it
#endif
#endif

#if defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__)
// Every way to the heap, operator new included, ends in one of these.
extern "C" {
void* __libc_malloc(size_t);
void* __libc_calloc(size_t, size_t);
void* __libc_realloc(void*, size_t);
void* __libc_memalign(size_t, size_t);
void* malloc(size_t size) { return ++allocations, __libc_malloc(size); }
void* calloc(size_t count, size_t size) { return ++allocations, __libc_calloc(count, size); }
void* realloc(void* memory, size_t size) { return ++allocations, __libc_realloc(memory, size); }
void* aligned_alloc(size_t alignment, size_t size) { return ++allocations, __libc_memalign(alignment, size); }
}
#endif

namespace {

std::mt19937 random_bits(2603);

std::vector<float> uniform(std::size_t count, float low, float high) {
  std::uniform_real_distribution<float> distribution(low, high);
  std::vector<float> values(count);
  for (float& value : values) value = distribution(random_bits);
  return values;
}

std::vector<std::int32_t> indices(std::size_t count, int limit) {
  std::vector<std::int32_t> values(count);
  for (auto& value : values) value = std::int32_t(random_bits() % unsigned(limit));
  return values;
}

struct Layers {
  std::vector<std::vector<float>> storage;
  std::vector<physkin::DenseWeights> layers;

  explicit Layers(const std::vector<int>& widths) {
    storage.reserve(2 * widths.size());
    for (std::size_t k = 0; k + 1 < widths.size(); ++k) {
      storage.push_back(uniform(std::size_t(widths[k]) * widths[k + 1], -0.1f, 0.1f));
      storage.push_back(uniform(widths[k + 1], -0.1f, 0.1f));
      layers.push_back({widths[k + 1], widths[k], storage[2 * k].data(), storage[2 * k + 1].data()});
    }
  }
};

struct Output {
  std::vector<float> values;
  physkin::VertexRows full, positions;

  explicit Output(int vertices) : values(6 * std::size_t(vertices)) {
    full = {reinterpret_cast<unsigned char*>(values.data()), 6, true};
    positions = {full.data, 3, false};
  }
};

// Frames of one garment, and of it twice; returns how often they reached the heap.
long run_frames(const physkin::BoundGarment& g, const physkin::Kernels& kernels, physkin::Precision precision) {
  physkin::Evaluator alone({g}, kernels, precision), two({g, g}, kernels, precision);
  Output one(g.vertex_count), first(g.vertex_count), second(g.vertex_count);
  const auto q = uniform(g.dofs, -1, 1);
  physkin::FrameInput input(2);
  const double wind[3] = {3, -1, 0};
  if (input.set_wind(wind) != nullptr) std::abort();
  const physkin::VertexRows full[] = {first.full, second.full}, positions[] = {first.positions, second.positions};
  const long before = allocations;
  for (int frame = 0; frame < 3; ++frame) {
    const double root[7] = {0.1 * frame, 0.2, 1, 0, 0, 0, 1};
    if (input.move(0.01 * frame, root) != nullptr || input.begin_frame(0.01 * frame) != nullptr) std::abort();
    if (alone.step(q.data(), input.rows(), &one.full) || two.step(q.data(), input.rows(), full)) std::abort();
#if !defined(__SANITIZE_ADDRESS__)  // whose checks stand between products and sums that are fused elsewhere
    if (one.values != first.values || one.values != second.values) std::abort();
#endif
    for (physkin::Evaluator* each : {&alone, &two}) {
      for (int k = 0; k < each->count(); ++k) each->set_fabric(k, frame - 1);
    }
    if (two.step(q.data(), input.rows(), positions) || alone.step(q.data(), input.rows(), &one.positions)) std::abort();
  }
  return allocations - before;
}

// A random garment of these sizes, with detail where `width` is odd, kept out of the skin where it is at most one above a
// multiple of four; `run_frames` evaluates it.
long run(const physkin::Kernels& kernels, physkin::Precision precision, int bones, int dofs, int nodes, int vertices,
         int influences, int width) {
  std::vector<std::int32_t> parents(bones);
  for (int j = 0; j < bones; ++j) parents[j] = j - 1;
  const auto heads = uniform(3 * bones, -1, 1), axis = uniform(3 * dofs, -1, 1), rest = uniform(dofs, -1, 1);
  const auto lower = uniform(dofs, -2, -1), upper = uniform(dofs, 1, 2);
  const auto dof_bone = indices(dofs, bones), node_bone = indices(nodes, bones);
  const auto positions = uniform(3 * nodes, -1, 1);
  const auto points = uniform(3 * vertices, -1, 1), normals = uniform(3 * vertices, -1, 1);
  const auto influence_nodes = indices(std::size_t(vertices) * influences, nodes);
  const auto weights = uniform(std::size_t(vertices) * influences, 0, 1);
  const Layers pose({dofs + 3, width, 4 * width}), deformer({12 * bones, width, width, 12 * nodes});
  const Layers driver({2 * dofs + 15, width, 3 * width}), reader({2 * width + 3 * dofs + 18, width, width, 12 * nodes});
  const auto modulation = uniform(2 * width, -0.2f, 0.2f), heavier = uniform(1, 0.5f, 2),
             shifts = uniform(2 * width, -1, 1);
  const auto rates = uniform(width, 1, 9), turns = uniform(width, 0, 9);
  std::vector<std::int32_t> joints(dofs);
  for (int k = 0; k < dofs; ++k) joints[k] = k;
  std::vector<std::int32_t> used(bones);
  for (int j = 0; j < bones; ++j) used[j] = j;

  physkin::BoundGarment g;
  g.bones = g.deformer_bone_count = bones;
  g.dofs = dofs;
  g.nodes = nodes;
  g.vertex_count = vertices;
  g.influences = influences;
  g.bone_parents = parents.data();
  g.bone_heads = heads.data();
  g.dof_bone = dof_bone.data();
  g.dof_axis = axis.data();
  g.dof_rest = rest.data();
  g.dof_lower = lower.data();
  g.dof_upper = upper.data();
  g.pose_layers = pose.layers;
  g.fabrics = 1;
  g.fabric_modulation = int(modulation.size());
  g.fabric_sway = int(shifts.size());
  g.fabric_modulations = modulation.data();
  g.fabric_weights = heavier.data();
  g.fabric_sway_shifts = shifts.data();
  g.deformer_bones = used.data();
  g.deformer_layers = deformer.layers;
  g.node_bone = node_bone.data();
  g.node_positions = g.node_rest = positions.data();
  g.vertices = points.data();
  g.normals = normals.data();
  g.influence_nodes = influence_nodes.data();
  g.influence_weights = weights.data();

  g.sway_joints = joints.data();
  g.sway_joint_count = dofs;
  g.sway_layers = driver.layers;
  g.sway_layers.insert(g.sway_layers.end(), reader.layers.begin(), reader.layers.end());
  g.sway_rates = rates.data();
  g.sway_turns = turns.data();
  g.sway_states = width;
  g.sway_thighs = node_bone.data();
  g.sway_thigh_count = std::min(nodes, 2);

  const bool detailed = width % 2 == 1, guarded = width % 4 < 2;
  const int detail_influences = 1 + vertices % 5, numbers = 3 * nodes;
  const Layers features({width, width + 2});
  const auto offsets = uniform(std::size_t(numbers) * (width + 2), -0.1f, 0.1f);
  const auto detail_nodes = indices(std::size_t(vertices) * detail_influences, nodes);
  const auto detail_weights = uniform(std::size_t(vertices) * detail_influences, 0, 1);
  g.detail_vertices = g.detail_influences = g.detail_numbers = g.detail_features = 0;
  if (detailed) {
    g.detail_vertices = vertices;
    g.detail_influences = detail_influences;
    g.detail_numbers = numbers;
    g.detail_features = width + 2;
    g.detail_layers = features.layers;
  }
  g.detail_offsets = offsets.data();
  g.detail_nodes = detail_nodes.data();
  g.detail_weights = detail_weights.data();

  const int samples = vertices / 2, parts = 2, splines = 4;
  const auto guarded_points = uniform(3 * samples, -1, 1), shares = uniform(samples, 0, 1);
  const auto guard_nodes = indices(std::size_t(samples) * influences, nodes);
  const auto guard_weights = uniform(std::size_t(samples) * influences, 0, 1);
  const auto ways = uniform(2 * parts * samples, -0.7f, 0.7f), gaps = uniform(parts * samples, 0, 0.01f),
             skin_frames = uniform(12 * parts, -1, 1);
  const float shapes[] = {0, 0, -1, 1, 0.1f, 0.2f, 0, -1, 0.5f, 0.1f};
  const auto skin_bones = indices(parts * physkin::kSkinBones, bones);
  const float heights[] = {
      -0.5f, 0, 0.5f, physkin::kNoHeight, 0, physkin::kNoHeight, physkin::kNoHeight, physkin::kNoHeight};
  const auto coefficients = uniform(std::size_t(parts) * splines * physkin::kTrunkWaves, 0.1f, 0.3f);
  g.guard.samples = guarded ? samples : 0;
  g.guard.influences = influences;
  g.skin_parts = guarded ? parts : 0;
  g.skin_splines = splines;
  g.guard.vertices = guarded_points.data();
  g.guard.influence_nodes = guard_nodes.data();
  g.guard.influence_weights = guard_weights.data();
  g.guard.detail_influences = detailed ? detail_influences : 0;
  g.guard.detail_nodes = detail_nodes.data();
  g.guard.detail_weights = detail_weights.data();
  g.guard_shares = shares.data();
  g.guard_gaps = gaps.data();
  g.guard_ways = ways.data();
  g.dent = g.guard;
  g.dent.samples = guarded && detailed ? samples : 0;
  const auto dent_nodes = indices(samples, numbers / 3);
  g.dent_nodes = dent_nodes.data();
  g.dent_shares = shares.data();
  const std::int32_t presses[] = {0, 1};
  g.skin_presses = presses;
  g.skin_frames = skin_frames.data();
  g.skin_shapes = shapes;
  g.skin_bones = skin_bones.data();
  g.skin_heights = heights;
  g.skin_coefficients = coefficients.data();

  const auto faces = indices(6 * std::size_t(vertices), vertices);
  g.faces = faces.data();
  g.face_count = vertices % 2 == 0 ? 2 * vertices : 0;

  return run_frames(g, kernels, precision);
}

}  // namespace

int main() {
  using physkin::Precision;
  for (const std::string& name : physkin::supported_instruction_sets()) {
    const physkin::Kernels& kernels = physkin::select_kernels(name);
    for (const Precision precision : {Precision::fp32, Precision::bf16, Precision::int8}) {
      for (const int size : {1, 2, 3, 7, 15, 16, 17, 31, 32, 33, 64, 100}) {
        const long count = run(kernels, precision, 1 + size / 3, size, size, 3 * size, 1 + size % 8, size);
        std::printf("%s %s %ld\n", name.c_str(), physkin::precision_name(precision), count);
      }
    }
  }
  return allocations > 0 ? 0 : 1;  // zero: the counting itself did not work
}

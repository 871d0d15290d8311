// The evaluator as a C++ library, without Python: counts what a frame allocates, on garments of odd sizes, alone and in
// a batch, which must give the same bits.
//
// Prints "<instruction set> <precision> <allocations>" for each garment. All buffers have their exact size,
// so that a build with the address sanitizer finds a kernel that reads or writes beyond them.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <random>
#include <vector>

#include "evaluator/evaluator.hpp"
#include "evaluator/evaluator_batch.hpp"
#include "kernels/dispatch.hpp"

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

// A frame of more bodies than are computed at once; returns how often it reached the heap.
long run_batch(physkin::BoundGarment g, const physkin::Kernels& kernels, physkin::EvaluatorOptions options) {
  constexpr int kBodies = physkin::kBatch + 2;
  const int dofs = g.dofs, vertices = g.vertex_count;
  int hidden = 0;
  for (std::size_t k = 0; k + 1 < g.pose_layers.size(); ++k) hidden += g.pose_layers[k].outputs;
  std::vector<std::vector<float>> modulations, first_layers;
  std::vector<physkin::BoundGarment> bodies;
  for (int body = 0; body < kBodies; ++body) {
    modulations.push_back(uniform(2 * std::size_t(hidden), -0.5f, 0.5f));
    first_layers.push_back(uniform(std::size_t(g.deformer_layers[0].outputs) * g.deformer_layers[0].inputs, -0.1f, 0.1f));
    g.pose_modulation = modulations.back().data();
    g.modulation_size = 2 * hidden;
    g.deformer_layers[0].matrix = first_layers.back().data();
    bodies.push_back(g);
  }
  physkin::EvaluatorBatch batch(bodies, kernels, options);
  const auto q = uniform(std::size_t(kBodies) * dofs, -1, 1), gravity = uniform(3 * kBodies, -1, 1);
  std::vector<std::vector<float>> out(kBodies, std::vector<float>(6 * std::size_t(vertices)));
  std::vector<physkin::VertexRows> rows;
  for (auto& values : out) rows.push_back({reinterpret_cast<unsigned char*>(values.data()), 6, true});
  const long before = allocations;
  if (batch.step(q.data(), gravity.data(), rows.data())) std::abort();
  const long count = allocations - before;
  for (int body = 0; body < kBodies; ++body) {
    std::vector<float> alone(6 * std::size_t(vertices));
    physkin::Evaluator evaluator(bodies[body], kernels, options);
    const physkin::VertexRows to{reinterpret_cast<unsigned char*>(alone.data()), 6, true};
    if (evaluator.step(q.data() + body * dofs, gravity.data() + 3 * body, to)) std::abort();
#if !defined(__SANITIZE_ADDRESS__)  // whose checks stand between products and sums that are fused elsewhere
    if (std::memcmp(alone.data(), out[body].data(), alone.size() * sizeof(float)) != 0) std::abort();
#endif
  }
  return count;
}

// Frames of one garment; returns how often they reached the heap.
long run(const physkin::Kernels& kernels, physkin::Precision precision, physkin::Activation activation, int bones,
         int dofs, int nodes, int vertices, int influences, int width) {
  std::vector<std::int32_t> parents(bones);
  for (int j = 0; j < bones; ++j) parents[j] = j - 1;
  const auto heads = uniform(3 * bones, -1, 1), axis = uniform(3 * dofs, -1, 1), rest = uniform(dofs, -1, 1);
  const auto lower = uniform(dofs, -2, -1), upper = uniform(dofs, 1, 2);
  const auto dof_bone = indices(dofs, bones), node_bone = indices(nodes, bones);
  const auto positions = uniform(3 * nodes, -1, 1), twist = uniform(nodes, 0, 1);
  const auto points = uniform(3 * vertices, -1, 1), normals = uniform(3 * vertices, -1, 1);
  const auto influence_nodes = indices(std::size_t(vertices) * influences, nodes);
  const auto weights = uniform(std::size_t(vertices) * influences, 0, 1);
  const Layers pose({dofs + 3, width, 4 * width}), deformer({12 * bones, width, width, 12 * nodes});
  const Layers driver({2 * dofs + 15, width, 3 * width}), reader({2 * width + 3 * dofs + 18, width, width, 12 * nodes});
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
  g.modulation_size = 0;
  g.bone_parents = parents.data();
  g.bone_heads = heads.data();
  g.dof_bone = dof_bone.data();
  g.dof_axis = axis.data();
  g.dof_rest = rest.data();
  g.dof_lower = lower.data();
  g.dof_upper = upper.data();
  g.activation = activation;
  g.pose_layers = pose.layers;
  g.deformer_bones = used.data();
  g.deformer_layers = deformer.layers;
  g.node_bone = node_bone.data();
  g.node_positions = g.node_rest = positions.data();
  g.vertices = points.data();
  g.normals = normals.data();
  g.influence_nodes = influence_nodes.data();
  g.influence_weights = weights.data();

  g.node_twist = twist.data();
  g.twist_size = nodes;
  g.sway_joints = joints.data();
  g.sway_joint_count = dofs;
  g.sway_layers = driver.layers;
  g.sway_layers.insert(g.sway_layers.end(), reader.layers.begin(), reader.layers.end());
  g.sway_rates = rates.data();
  g.sway_turns = turns.data();
  g.sway_states = width;

  const auto faces = indices(6 * std::size_t(vertices), vertices);
  g.faces = faces.data();
  g.face_count = 2 * vertices;
  physkin::EvaluatorOptions options{precision, physkin::Normals::skinned};
  if (vertices % 2 == 0) options.normals = physkin::Normals::faces;

  physkin::Evaluator evaluator(g, kernels, options);
  std::vector<float> out(6 * std::size_t(vertices));
  const auto q = uniform(dofs, -1, 1), gravity = uniform(3, -1, 1);
  const physkin::VertexRows full{reinterpret_cast<unsigned char*>(out.data()), 6, true};
  const physkin::VertexRows positions_only{full.data, 3, false};
  const long before = allocations;
  const physkin::Moment moment{0.5f, 1e-3f, 1.0f, 1e-3f, 1.0f, {0.1f, 0.2f, 0.3f}, {0.3f, 0.2f, 0.1f}};
  for (int frame = 0; frame < 3; ++frame) {
    if (evaluator.step(q.data(), gravity.data(), full, &moment)) std::abort();
    if (evaluator.step(q.data(), gravity.data(), positions_only, &moment)) std::abort();
  }
  const long alone = allocations - before;
  return alone + run_batch(g, kernels, options);
}

}  // namespace

int main() {
  using physkin::Activation;
  using physkin::Precision;
  for (const std::string& name : physkin::supported_instruction_sets()) {
    const physkin::Kernels& kernels = physkin::select_kernels(name);
    for (const Precision precision : {Precision::fp32, Precision::bf16, Precision::int8}) {
      for (const int size : {1, 2, 3, 7, 15, 16, 17, 31, 32, 33, 64, 100}) {
        const Activation activation = size % 2 != 0 ? Activation::relu : Activation::silu;
        const long count =
            run(kernels, precision, activation, 1 + size / 3, size, size, 3 * size, 1 + size % 8, size);
        std::printf("%s %s %ld\n", name.c_str(), physkin::precision_name(precision), count);
      }
    }
  }
  return allocations > 0 ? 0 : 1;  // zero: the counting itself did not work
}

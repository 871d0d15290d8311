#include "evaluator.hpp"

#include <algorithm>
#include <cfloat>
#include <stdexcept>
#include <string>

#include "finite.hpp"
#include "skinning_blocks.hpp"

namespace physkin {
namespace {

// Metres; far beyond any garment, and small enough that nothing computed from it overflows.
constexpr float kLargest = 1e6f;

void check(const char* name, const float* values, std::size_t count, float limit) {
  const std::size_t bad = first_beyond(values, count, limit);
  if (bad < count) {
    throw std::invalid_argument(std::string(name) + "[" + std::to_string(bad) + "] is " + std::to_string(values[bad]) +
                                "; every value must be finite and within +-" + std::to_string(limit));
  }
}

const BoundGarment& validated(const BoundGarment& garment) {
  validate(garment);
  return garment;
}

}  // namespace

Evaluator::Evaluator(const BoundGarment& g, const Kernels& kernels, const BoundPushOut* push_out)
    : kernels_(kernels),
      rig_(validated(g), arena_),
      pose_modulator_(g.pose_layers, g.activation, arena_),
      node_deformer_(g.deformer_layers, g.activation, arena_),
      garment_nodes_(g, arena_),
      blocks_(pack_skinning_blocks(g, arena_)),
      deformer_bone_count_(g.deformer_bone_count),
      deformer_bones_(arena_.copy(g.deformer_bones, g.deformer_bone_count)),
      pose_(arena_.take<float>(g.dofs + 3)),
      bone_transforms_(arena_.take<float>(12 * g.bones)),
      deformer_input_(arena_.take<float>(12 * g.deformer_bone_count)),
      node_transforms_(arena_.take<float>(12 * g.nodes)),
      skinning_matrices_(arena_.take<float>(12 * g.nodes)) {
  if (push_out != nullptr) push_out_.emplace(*push_out, g.bones, g.vertex_count, arena_);
}

void Evaluator::evaluate(const float* joint_positions, const float* gravity, const VertexRows& rows) {
  check("joint_positions", joint_positions, rig_.dofs(), FLT_MAX);
  check("gravity", gravity, 3, FLT_MAX);

  rig_.compute_bone_transforms(joint_positions, bone_transforms_);
  rig_.compute_pose_vector(joint_positions, gravity, pose_);
  for (int k = 0; k < deformer_bone_count_; ++k) {
    std::copy_n(bone_transforms_ + 12 * deformer_bones_[k], 12, deformer_input_ + 12 * k);
  }
  const float* modulation = pose_modulator_.run(kernels_, pose_, nullptr);
  const float* corrections = node_deformer_.run(kernels_, deformer_input_, modulation);
  check("node deformer output", corrections, node_deformer_.outputs(), kLargest);

  garment_nodes_.compose(bone_transforms_, corrections, node_transforms_);
  skin(node_transforms_, rows);
  if (push_out_) residual_ = push_out_->apply(kernels_, bone_transforms_, rows);
}

void Evaluator::skin(const float* node_transforms, const VertexRows& rows) {
  check("node_transforms", node_transforms, 12 * std::size_t(nodes()), kLargest);
  garment_nodes_.compute_skinning_matrices(node_transforms, skinning_matrices_);
  kernels_.skin(blocks_, skinning_matrices_, rows);
}

}  // namespace physkin

#include "evaluator/evaluator_batch.hpp"

#include <cstring>
#include <stdexcept>
#include <string>

namespace physkin {
namespace {

bool same_layer(const DenseWeights& a, const DenseWeights& b) {
  const std::size_t weights = std::size_t(a.outputs) * a.inputs * sizeof(float);
  return a.outputs == b.outputs && a.inputs == b.inputs &&
         (a.matrix == b.matrix || std::memcmp(a.matrix, b.matrix, weights) == 0) &&
         (a.bias == b.bias || std::memcmp(a.bias, b.bias, a.outputs * sizeof(float)) == 0);
}

bool same_layers(const std::vector<DenseWeights>& a, const std::vector<DenseWeights>& b, std::size_t first) {
  if (a.size() != b.size()) return false;
  for (std::size_t k = first; k < a.size(); ++k) {
    if (!same_layer(a[k], b[k])) return false;
  }
  return true;
}

// The first layer of the node deformer is the body's own, but has as many outputs on each.
bool same_networks(const BoundGarment& a, const BoundGarment& b) {
  return a.activation == b.activation && a.dofs == b.dofs && a.vertex_count == b.vertex_count &&
         same_layers(a.pose_layers, b.pose_layers, 0) && same_layers(a.deformer_layers, b.deformer_layers, 1) &&
         a.deformer_layers[0].outputs == b.deformer_layers[0].outputs;
}

}  // namespace

EvaluatorBatch::EvaluatorBatch(const std::vector<BoundGarment>& garments, const Kernels& kernels,
                               const EvaluatorOptions& options) {
  if (garments.empty()) throw std::invalid_argument("a batch needs at least one bound garment");
  for (std::size_t k = 0; k < garments.size(); ++k) {
    validate(garments[k]);
    if (!same_networks(garments[0], garments[k])) {
      throw std::invalid_argument("bound garment " + std::to_string(k) + " of a batch has other networks than the " +
                                  "first; all must be of one garment model, with the modulation not folded in");
    }
    const Evaluator* shared = k == 0 ? nullptr : evaluators_[0].get();
    evaluators_.push_back(std::make_unique<Evaluator>(garments[k], kernels, options, shared));
    Evaluator& evaluator = *evaluators_.back();
    pose_modulators_.push_back(&evaluator.pose_modulator_);
    node_deformers_.push_back(&evaluator.node_deformer_);
    poses_.push_back(evaluator.pose_);
    body_modulations_.push_back(evaluator.pose_modulation_);
    deformer_inputs_.push_back(evaluator.deformer_input_);
  }
  modulations_.resize(garments.size());
  corrections_.resize(garments.size());
}

Rejection EvaluatorBatch::step(const float* joint_positions, const float* gravity, const VertexRows* rows) noexcept {
  const int dofs = evaluators_[0]->dofs();
  for (rejected_ = 0; rejected_ < count(); ++rejected_) {
    const Evaluator& e = *evaluators_[rejected_];
    if (const auto bad = e.check_inputs(joint_positions + rejected_ * dofs, gravity + 3 * rejected_)) return bad;
  }
  for (int k = 0; k < count(); ++k) evaluators_[k]->pose(joint_positions + k * dofs, gravity + 3 * k);
  Mlp::run_batch(pose_modulators_.data(), count(), poses_.data(), body_modulations_.data(), modulations_.data());
  Mlp::run_batch(node_deformers_.data(), count(), deformer_inputs_.data(), modulations_.data(), corrections_.data());
  for (rejected_ = 0; rejected_ < count(); ++rejected_) {
    Evaluator& e = *evaluators_[rejected_];
    e.corrections_ = corrections_[rejected_];
    if (const auto bad = e.check_corrections()) return bad;
    e.compose_nodes(e.corrections_);
    if (const auto bad = e.skinner_.check(e.node_transforms_)) return bad;
  }
  for (int k = 0; k < count(); ++k) {
    Evaluator& e = *evaluators_[k];
    e.skinner_.skin(e.node_transforms_, rows[k]);
    e.compute_normals(rows[k]);
  }
  rejected_ = -1;
  return {};
}

}  // namespace physkin

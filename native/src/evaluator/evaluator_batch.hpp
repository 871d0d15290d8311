// The same garment on several bodies, their frames computed together: network weights are kept, and read, once.
#pragma once

#include <memory>
#include <vector>

#include "evaluator/evaluator.hpp"

namespace physkin {

// What differs from body to body: bones, node positions, the node deformer's first layer (folded onto the body's bones)
// and the modulation, which is applied instead of folded in.
class EvaluatorBatch {
 public:
  // Throws std::invalid_argument if there is no garment, one is malformed, or their networks differ in more than that.
  EvaluatorBatch(const std::vector<BoundGarment>& garments, const Kernels& kernels,
                 const EvaluatorOptions& options);
  EvaluatorBatch(const EvaluatorBatch&) = delete;
  EvaluatorBatch& operator=(const EvaluatorBatch&) = delete;

  // A frame of every body, the same bits as one by one. joint_positions (count, dofs), gravity (count, 3), rows one a
  // body. At a rejection the rows of all are as they were, and `rejected` is the body's index. Allocates nothing.
  Rejection step(const float* joint_positions, const float* gravity, const VertexRows* rows) noexcept;

  int count() const { return int(evaluators_.size()); }
  int rejected() const { return rejected_; }
  Evaluator& operator[](int body) { return *evaluators_[std::size_t(body)]; }
  const Evaluator& operator[](int body) const { return *evaluators_[std::size_t(body)]; }

 private:
  std::vector<std::unique_ptr<Evaluator>> evaluators_;
  std::vector<Mlp*> pose_modulators_, node_deformers_;
  std::vector<const float*> poses_, body_modulations_, deformer_inputs_, modulations_, corrections_;
  int rejected_ = -1;
};

}  // namespace physkin

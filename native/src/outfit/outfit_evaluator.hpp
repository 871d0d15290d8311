// Garments worn over each other, a frame of all of them in one pass. Single-threaded; a frame allocates nothing.
#pragma once

#include <memory>
#include <vector>

#include "evaluator/evaluator.hpp"
#include "outfit/layer_order.hpp"

namespace physkin {

// Of which two layers the order is kept: which stays as it is, and which is moved.
struct LayerPair {
  int steady = 0, yielding = 0;
};

// Gravity of all garments, or one each: 3 numbers, or more, with the moment behind it.
struct Gravities {
  const float* values;
  bool each = false;
  int size = kGravityAlone;

  const float* of(int garment) const { return values + (each ? size * garment : 0); }
  std::optional<Moment> moment(int garment) const { return moment_after(of(garment), size); }
};

class OutfitEvaluator {
 public:
  // Garments on one body, the innermost first. Throws std::invalid_argument if there is none, one is malformed, or they
  // have not one rig.
  OutfitEvaluator(const std::vector<BoundGarment>& garments, const Kernels& kernels, const EvaluatorOptions& options);
  OutfitEvaluator(const OutfitEvaluator&) = delete;
  OutfitEvaluator& operator=(const OutfitEvaluator&) = delete;

  // The yielding layer is moved outwards if it is the outer one, or else inwards. Throws std::invalid_argument for
  // layers that are not there, and as LayerOrder does.
  void keep_order(LayerPair layers, const LayerOrderData& order);

  // One frame; rows one a garment. Bone transforms and pose vector are computed once. At a rejection the rows are as
  // they were, and `rejected` is the garment's index.
  Rejection step(const float* joint_positions, const Gravities& gravity, const VertexRows* rows) noexcept;

  // Of the last frame, for timing: every garment skinned into its rows; then the order of all layers.
  void skin(const VertexRows* rows) noexcept;
  void keep(const VertexRows* rows) noexcept;

  int count() const { return int(evaluators_.size()); }
  int rejected() const { return rejected_; }
  Evaluator& operator[](int garment) { return *evaluators_[std::size_t(garment)]; }
  const Evaluator& operator[](int garment) const { return *evaluators_[std::size_t(garment)]; }

 private:
  struct Kept {
    LayerPair layers;
    std::unique_ptr<LayerOrder> order;
  };

  void keep_under(int outer, const VertexRows* rows, bool look_at_all) noexcept;

  Arena arena_;
  std::vector<std::unique_ptr<Evaluator>> evaluators_;
  std::vector<Kept> orders_;
  std::vector<VertexRows> own_rows_;  // with normals, where the caller's have none
  bool jumped_ = true;  // since layers were last put in order
  int rejected_ = -1;
};

}  // namespace physkin

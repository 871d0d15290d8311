// A frame of one garment, or of several worn over each other on one body. Single-threaded; a frame allocates nothing.
#pragma once

#include <memory>
#include <vector>

#include "evaluator/garment_evaluator.hpp"
#include "outfit/layer_order.hpp"

namespace physkin {

// Of which two layers the order is kept: which stays as it is, and which is moved.
struct LayerPair {
  int steady = 0, yielding = 0;
};

class Evaluator {
 public:
  // Garments on one body, the innermost first. Throws std::invalid_argument if there is none, one is malformed, or they
  // have not one rig.
  Evaluator(const std::vector<BoundGarment>& garments, const Kernels& kernels, Precision precision);
  Evaluator(const Evaluator&) = delete;
  Evaluator& operator=(const Evaluator&) = delete;

  // The yielding layer is moved outwards if it is the outer one, or else inwards. Throws std::invalid_argument for
  // layers that are not there, and as LayerOrder does.
  void keep_order(LayerPair layers, const LayerOrderData& order);

  // As of GarmentEvaluator.
  void set_fabric(int garment, int fabric) noexcept { garments_[std::size_t(garment)]->set_fabric(fabric); }

  // One frame. joint_positions (dofs) in radians; inputs and rows one a garment. Bone transforms and pose vector are
  // computed once. If an input or what the networks make of it is not finite, says so and leaves the rows as they were:
  // `rejected` is then the garment's index.
  Rejection step(const float* joint_positions, const GarmentInput* inputs, const VertexRows* rows) noexcept;

  // The next frame goes on from none: layers look for each other anew.
  void forget() noexcept {
    jumped_ = true;
    for (Kept& kept : orders_) kept.order->forget();
  }

  // Single stages of the last frame once more, for timing.
  void pose(const float* joint_positions, const GarmentInput* inputs) noexcept;
  void run_networks(const GarmentInput* inputs) noexcept;
  void compose_nodes(const GarmentInput* inputs) noexcept;
  void skin(const VertexRows* rows) noexcept;
  void keep(const VertexRows* rows) noexcept;
  void compute_normals(const VertexRows* rows) noexcept;

  // As of GarmentEvaluator.
  void measure_clearance(int garment, float* clearance) noexcept {
    garments_[std::size_t(garment)]->measure_clearance(clearance);
  }

  int count() const { return int(garments_.size()); }
  int dofs() const { return garments_.front()->dofs(); }
  int rejected() const { return rejected_; }
  const GarmentEvaluator& operator[](int garment) const { return *garments_[std::size_t(garment)]; }
  const char* instruction_set() const { return kernels_.instruction_set; }
  Precision precision() const { return precision_; }

 private:
  struct Kept {
    LayerPair layers;
    std::unique_ptr<LayerOrder> order;
  };

  bool are_ordered() const { return !orders_.empty(); }
  Rejection run(const float* joint_positions, const GarmentInput* inputs) noexcept;
  // inputs: none, where pushes need not keep their pace.
  void keep_under(int outer, const VertexRows* rows, bool look_at_all, const GarmentInput* inputs) noexcept;

  const Kernels& kernels_;
  Precision precision_;
  Arena arena_{kHugePage};
  std::vector<std::unique_ptr<GarmentEvaluator>> garments_;
  std::vector<Kept> orders_;
  std::vector<VertexRows> own_rows_;  // with normals, where the caller's have none
  bool jumped_ = true;                // since layers were last put in order
  int rejected_ = -1;
};

}  // namespace physkin

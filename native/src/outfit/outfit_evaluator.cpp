#include "outfit/outfit_evaluator.hpp"

#include <algorithm>
#include <cstring>
#include <stdexcept>

namespace physkin {
namespace {

constexpr int kColumns = 6;

bool same_rig(const BoundGarment& a, const BoundGarment& b) {
  return a.bones == b.bones && a.dofs == b.dofs && std::equal(a.bone_parents, a.bone_parents + a.bones, b.bone_parents) &&
         std::equal(a.bone_heads, a.bone_heads + 3 * a.bones, b.bone_heads) &&
         std::equal(a.dof_bone, a.dof_bone + a.dofs, b.dof_bone) &&
         std::equal(a.dof_axis, a.dof_axis + 3 * a.dofs, b.dof_axis) &&
         std::equal(a.dof_rest, a.dof_rest + a.dofs, b.dof_rest) &&
         std::equal(a.dof_lower, a.dof_lower + a.dofs, b.dof_lower) &&
         std::equal(a.dof_upper, a.dof_upper + a.dofs, b.dof_upper);
}

}  // namespace

OutfitEvaluator::OutfitEvaluator(const std::vector<BoundGarment>& garments, const Kernels& kernels,
                                 const EvaluatorOptions& options) {
  if (garments.empty()) throw std::invalid_argument("an outfit needs at least one garment");
  for (const BoundGarment& garment : garments) {
    evaluators_.push_back(std::make_unique<Evaluator>(garment, kernels, options));
    if (!same_rig(garments.front(), garment)) {
      throw std::invalid_argument("garment " + std::to_string(evaluators_.size() - 1) +
                                  " has another rig or body than garment 0; an outfit has one");
    }
    const std::size_t size = kColumns * std::size_t(garment.vertex_count);
    auto* own = reinterpret_cast<unsigned char*>(arena_.take<float>(size));
    own_rows_.push_back({own, kColumns, true});
  }
}

void OutfitEvaluator::keep_order(LayerPair layers, const LayerOrderData& order) {
  const auto [steady, yielding] = layers;
  if (std::min(steady, yielding) < 0 || std::max(steady, yielding) >= count() || steady == yielding) {
    throw std::invalid_argument("layers " + std::to_string(steady) + " and " + std::to_string(yielding) +
                                " must be two of " + std::to_string(count()));
  }
  const Side side = yielding > steady ? Side::kOutside : Side::kInside;
  orders_.push_back({layers, std::make_unique<LayerOrder>(order, side, (*this)[steady].vertex_count(),
                                                          (*this)[yielding].vertex_count(), arena_)});
}

Rejection OutfitEvaluator::step(const float* joint_positions, const Gravities& gravity,
                                const VertexRows* rows) noexcept {
  Evaluator& first = *evaluators_.front();
  rejected_ = 0;
  first.pose(joint_positions, gravity.of(0));
  for (; rejected_ < count(); ++rejected_) {
    Evaluator& e = *evaluators_[std::size_t(rejected_)];
    const std::optional<Moment> moment = gravity.moment(rejected_);
    const Moment* told = moment ? &*moment : nullptr;
    if (const auto bad = e.check_inputs(joint_positions, gravity.of(rejected_), told)) return bad;
    if (rejected_ > 0) e.pose_as(first, gravity.of(rejected_));
    jumped_ |= e.jumped();
    e.run_networks(told);
    if (const auto bad = e.check_corrections()) return bad;
    e.compose_nodes(e.corrections_, told);
    if (const auto bad = e.check_nodes()) return bad;
  }
  rejected_ = -1;
  const bool look_at_all = jumped_;
  jumped_ = false;
  const VertexRows* with_normals = rows;
  const bool copied = !orders_.empty() && !rows[0].with_normals;
  if (copied) with_normals = own_rows_.data();
  for (int k = 0; k < count(); ++k) {
    Evaluator& e = *evaluators_[std::size_t(k)];
    e.skinner_.skin(e.node_transforms_, with_normals[k]);
    keep_under(k, with_normals, look_at_all);
  }
  for (int k = 0; k < count(); ++k) {
    if (!copied) {
      (*this)[k].compute_normals(rows[k]);
      continue;
    }
    const std::ptrdiff_t from = kColumns * sizeof(float), to = rows[k].stride * std::ptrdiff_t(sizeof(float));
    for (int v = 0; v < (*this)[k].vertex_count(); ++v) {
      std::memcpy(rows[k].data + v * to, own_rows_[std::size_t(k)].data + v * from, 3 * sizeof(float));
    }
  }
  return {};
}

void OutfitEvaluator::skin(const VertexRows* rows) noexcept {
  for (int k = 0; k < count(); ++k) (*this)[k].skinner_.skin((*this)[k].node_transforms_, rows[k]);
}

void OutfitEvaluator::keep(const VertexRows* rows) noexcept {
  for (int k = 0; k < count(); ++k) keep_under(k, rows, false);
}

void OutfitEvaluator::keep_under(int outer, const VertexRows* rows, bool look_at_all) noexcept {
  for (Kept& kept : orders_) {
    const auto [steady, yielding] = kept.layers;
    if (std::max(steady, yielding) == outer) kept.order->apply(rows[steady], rows[yielding], look_at_all);
  }
}

}  // namespace physkin

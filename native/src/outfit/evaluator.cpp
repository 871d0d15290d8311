#include "outfit/evaluator.hpp"

#include <algorithm>
#include <cfloat>
#include <cstring>
#include <stdexcept>

namespace physkin {
namespace {

constexpr int kColumns = 6;

bool same_rig(const BoundGarment& a, const BoundGarment& b) {
  return a.bones == b.bones && a.dofs == b.dofs &&
         std::equal(a.bone_parents, a.bone_parents + a.bones, b.bone_parents) &&
         std::equal(a.bone_heads, a.bone_heads + 3 * a.bones, b.bone_heads) &&
         std::equal(a.dof_bone, a.dof_bone + a.dofs, b.dof_bone) &&
         std::equal(a.dof_axis, a.dof_axis + 3 * a.dofs, b.dof_axis) &&
         std::equal(a.dof_rest, a.dof_rest + a.dofs, b.dof_rest) &&
         std::equal(a.dof_lower, a.dof_lower + a.dofs, b.dof_lower) &&
         std::equal(a.dof_upper, a.dof_upper + a.dofs, b.dof_upper);
}

Rejection check(const GarmentInput& input) {
  if (const auto bad = reject_beyond("gravity", input.gravity, 3, FLT_MAX)) return bad;
  const std::pair<const char*, const float*> scalars[] = {
      {"passed", &input.passed}, {"sway", &input.sway}, {"elapsed", &input.elapsed}, {"moves", &input.moves}};
  for (const auto& [name, value] : scalars) {
    if (const auto bad = reject_beyond(name, value, 1, FLT_MAX)) return bad;
  }
  if (const auto bad = reject_beyond("velocity", input.velocity, 3, FLT_MAX)) return bad;
  return reject_beyond("turning", input.turning, 3, FLT_MAX);
}

}  // namespace

Evaluator::Evaluator(const std::vector<BoundGarment>& garments, const Kernels& kernels, Precision precision)
    : kernels_(kernels), precision_(precision) {
  if (garments.empty()) throw std::invalid_argument("there must be at least one garment to evaluate");
  for (const BoundGarment& garment : garments) {
    garments_.push_back(std::make_unique<GarmentEvaluator>(garment, kernels, precision));
    if (!same_rig(garments.front(), garment)) {
      throw std::invalid_argument("garment " + std::to_string(garments_.size() - 1) +
                                  " has another rig or body than garment 0; they must have one");
    }
  }
}

void Evaluator::keep_order(LayerPair layers, const LayerOrderData& order) {
  const auto [steady, yielding] = layers;
  if (std::min(steady, yielding) < 0 || std::max(steady, yielding) >= count() || steady == yielding) {
    throw std::invalid_argument("layers " + std::to_string(steady) + " and " + std::to_string(yielding) +
                                " must be two of " + std::to_string(count()));
  }
  const Side side = yielding > steady ? Side::kOutside : Side::kInside;
  orders_.push_back({layers, std::make_unique<LayerOrder>(order, side, (*this)[steady].vertex_count(),
                                                          (*this)[yielding].vertex_count(), arena_)});
  if (!own_rows_.empty()) return;
  for (const auto& garment : garments_) {
    auto* own = arena_.take<float>(kColumns * std::size_t(garment->vertex_count()));
    own_rows_.push_back({reinterpret_cast<unsigned char*>(own), kColumns, true});
  }
}

Rejection Evaluator::step(const float* joint_positions, const GarmentInput* inputs, const VertexRows* rows) noexcept {
  rejected_ = 0;
  if (const auto bad = reject_beyond("joint_positions", joint_positions, std::size_t(dofs()), FLT_MAX)) return bad;
  if (const auto bad = run(joint_positions, inputs)) return bad;
  rejected_ = -1;
  const bool look_at_all = jumped_, copied = are_ordered() && !rows[0].with_normals;
  jumped_ = false;
  const VertexRows* with_normals = copied ? own_rows_.data() : rows;
  for (int k = 0; k < count(); ++k) {
    garments_[std::size_t(k)]->skin(with_normals[k], are_ordered());
    keep_under(k, with_normals, look_at_all, inputs);
  }
  if (!copied) {
    compute_normals(rows);
    return {};
  }
  for (int k = 0; k < count(); ++k) {
    const std::ptrdiff_t from = kColumns * sizeof(float), to = rows[k].stride * std::ptrdiff_t(sizeof(float));
    for (int v = 0; v < (*this)[k].vertex_count(); ++v) {
      std::memcpy(rows[k].data + v * to, own_rows_[std::size_t(k)].data + v * from, 3 * sizeof(float));
    }
  }
  return {};
}

// To garment nodes, garment by garment: each one's network weights are then where its own frame left them.
Rejection Evaluator::run(const float* joint_positions, const GarmentInput* inputs) noexcept {
  for (; rejected_ < count(); ++rejected_) {
    GarmentEvaluator& garment = *garments_[std::size_t(rejected_)];
    const GarmentInput& input = inputs[rejected_];
    if (const auto bad = check(input)) return bad;
    if (rejected_ == 0) {
      garment.pose(joint_positions, input);
    } else {
      garment.pose_as(*garments_.front(), input);
    }
    jumped_ |= garment.jumped();
    garment.run_networks(input);
    if (const auto bad = garment.check_corrections()) return bad;
    garment.compose_nodes(input);
    if (const auto bad = garment.check_nodes()) return bad;
  }
  return {};
}

void Evaluator::pose(const float* joint_positions, const GarmentInput* inputs) noexcept {
  garments_.front()->pose(joint_positions, inputs[0]);
  for (int k = 1; k < count(); ++k) garments_[std::size_t(k)]->pose_as(*garments_.front(), inputs[k]);
}

void Evaluator::run_networks(const GarmentInput* inputs) noexcept {
  for (int k = 0; k < count(); ++k) garments_[std::size_t(k)]->run_networks(inputs[k]);
}

void Evaluator::compose_nodes(const GarmentInput* inputs) noexcept {
  for (int k = 0; k < count(); ++k) garments_[std::size_t(k)]->compose_nodes(inputs[k]);
}

void Evaluator::skin(const VertexRows* rows) noexcept {
  for (int k = 0; k < count(); ++k) garments_[std::size_t(k)]->skin(rows[k], are_ordered());
}

void Evaluator::keep(const VertexRows* rows) noexcept {
  for (int k = 0; k < count(); ++k) keep_under(k, rows, false, nullptr);
}

void Evaluator::compute_normals(const VertexRows* rows) noexcept {
  for (int k = 0; k < count(); ++k) garments_[std::size_t(k)]->compute_normals(rows[k], are_ordered());
}

void Evaluator::keep_under(int outer, const VertexRows* rows, bool look_at_all, const GarmentInput* inputs) noexcept {
  for (Kept& kept : orders_) {
    const auto [steady, yielding] = kept.layers;
    if (std::max(steady, yielding) != outer) continue;
    const float passed = look_at_all || inputs == nullptr ? -1.0f : inputs[yielding].passed;
    kept.order->apply(rows[steady], rows[yielding], look_at_all, passed);
  }
}

}  // namespace physkin

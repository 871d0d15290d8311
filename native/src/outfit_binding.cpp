// The part of physkin_core._native that drapes outfits: checks and converts, computes nothing.
#include "outfit_binding.hpp"

#include "outfit/outfit_evaluator.hpp"
#include "python_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace physkin {
namespace {

// The evaluator of an outfit with room for its converted inputs.
class BoundOutfit {
 public:
  BoundOutfit(const nb::list& garments, const nb::list& orders, const Text& instruction_set, const Text& precision,
              const std::string& normals)
      : outfit_(evaluator_of<OutfitEvaluator>(garments, instruction_set, precision, normals)),
        joint_positions_(std::size_t(outfit_[0].dofs())),
        gravity_(kGravityAndMoment * std::size_t(outfit_.count())) {
    PythonReader reader;
    for (nb::handle order : orders) {
      LayerOrderData data = read_layer_order(reader.fields_of(order));
      data.edge = nb::cast<float>(order.attr("edge"));
      const LayerPair layers{nb::cast<int>(order.attr("steady")), nb::cast<int>(order.attr("yielding"))};
      outfit_.keep_order(layers, data);
    }
  }

  void evaluate(const AnyArray& joint_positions, const AnyArray& gravity, const std::vector<OutputArray>& outs) {
    read_vector(joint_positions, "joint_positions", outfit_[0].dofs(), joint_positions_.data());
    const bool each = gravity.ndim() != 1;
    const int size = gravity_size(gravity);
    if (each) {
      read_array(gravity, "gravity", {outfit_.count(), size}, gravity_.data());
    } else {
      read_vector(gravity, "gravity", size, gravity_.data());
    }
    step(joint_positions_.data(), {gravity_.data(), each, size}, rows_of(outs));
  }

  void step(const float* joint_positions, const Gravities& gravity, const std::vector<VertexRows>& rows) {
    if (const Rejection bad = outfit_.step(joint_positions, gravity, rows.data())) {
      throw nb::value_error(("garment " + std::to_string(outfit_.rejected()) + ": " + bad.message()).c_str());
    }
  }

  std::vector<VertexRows> rows_of(const std::vector<OutputArray>& outs) const {
    if (outs.size() != std::size_t(outfit_.count())) {
      throw nb::value_error(("out has " + std::to_string(outs.size()) + " arrays; expected one for each of " +
                             std::to_string(outfit_.count()) + " garments").c_str());
    }
    std::vector<VertexRows> rows;
    for (std::size_t k = 0; k < outs.size(); ++k) {
      rows.push_back(vertex_rows(outs[k], outfit_[int(k)].vertex_count()));
      if (rows[k].with_normals != rows[0].with_normals) {
        throw nb::value_error("arrays of out must all have normals, or none");
      }
    }
    return rows;
  }

  OutfitEvaluator& outfit() { return outfit_; }

 private:
  OutfitEvaluator outfit_;
  std::vector<float> joint_positions_, gravity_;
};

// Of the last frame, a view that lives as long as the outfit.
nb::ndarray<nb::numpy, const float, nb::shape<-1, 3, 4>> node_transforms(BoundOutfit& self, int garment) {
  if (garment < 0 || garment >= self.outfit().count()) {
    throw nb::index_error(("garment " + std::to_string(garment) + " of " + std::to_string(self.outfit().count())).c_str());
  }
  const Evaluator& evaluator = self.outfit()[garment];
  return {evaluator.node_transforms(), {std::size_t(evaluator.nodes()), 3, 4}, nb::find(self)};
}

// A frame whose arrays were checked once: a call converts and allocates nothing. Keeps evaluator and arrays alive.
class BoundOutfitStep {
 public:
  using InputArray = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
  using GravityArray = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;

  BoundOutfitStep(nb::handle outfit, InputArray joint_positions, GravityArray gravity, std::vector<OutputArray> outs)
      : owner_(nb::borrow(outfit)),
        bound_(nb::cast<BoundOutfit&>(outfit)),
        joint_positions_(std::move(joint_positions)),
        gravity_(std::move(gravity)),
        outs_(std::move(outs)),
        rows_(bound_.rows_of(outs_)) {
    check_shape(joint_positions_, "joint_positions", {bound_.outfit()[0].dofs()});
    if (gravity_.ndim() == 1) {
      check_shape(gravity_, "gravity", {gravity_size(gravity_)});
    } else {
      check_shape(gravity_, "gravity", {bound_.outfit().count(), gravity_size(gravity_)});
    }
  }

  void step() {
    bound_.step(joint_positions_.data(), {gravity_.data(), gravity_.ndim() != 1, gravity_size(gravity_)}, rows_);
  }
  void skin() { bound_.outfit().skin(rows_.data()); }
  void keep() {
    if (rows_[0].with_normals) bound_.outfit().keep(rows_.data());
  }

 private:
  nb::object owner_;
  BoundOutfit& bound_;
  InputArray joint_positions_;
  GravityArray gravity_;
  std::vector<OutputArray> outs_;
  std::vector<VertexRows> rows_;
};

}  // namespace

void bind_outfit(nb::module_& module) {
  nb::class_<BoundOutfit>(module, "Outfit")
      .def(nb::init<const nb::list&, const nb::list&, const Text&, const Text&, const std::string&>(),
           "garments"_a, "orders"_a, "instruction_set"_a = nb::none(), "precision"_a = nb::none(),
           "normals"_a = "skinned")
      .def("evaluate", &BoundOutfit::evaluate, "joint_positions"_a.noconvert(), "gravity"_a.noconvert(),
           "outs"_a.noconvert())
      .def("node_transforms", node_transforms, "garment"_a)
      .def_prop_ro("instruction_set", [](BoundOutfit& self) { return self.outfit()[0].instruction_set(); })
      .def_prop_ro("precision", [](BoundOutfit& self) { return precision_name(self.outfit()[0].precision()); });
  nb::class_<BoundOutfitStep>(module, "OutfitStep")
      .def(nb::init<nb::handle, BoundOutfitStep::InputArray, BoundOutfitStep::GravityArray, std::vector<OutputArray>>(),
           "outfit"_a, "joint_positions"_a.noconvert(), "gravity"_a.noconvert(), "outs"_a.noconvert())
      .def("step", &BoundOutfitStep::step, "Computes one frame from what the bound input arrays hold now.")
      .def("skin", &BoundOutfitStep::skin)
      .def("keep", &BoundOutfitStep::keep);
}

}  // namespace physkin

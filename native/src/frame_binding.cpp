// The part of physkin_core._native that computes frames: checks and converts, computes nothing.
#include "bindings.hpp"
#include "outfit/evaluator.hpp"
#include "python_arrays.hpp"
#include "sway/frame_input.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace physkin {
namespace {

using Vector = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Outputs = std::vector<OutputArray>;

const double* vector_of(const Vector& array, const char* name, int size) {
  check_shape(array, name, {size});
  return array.data();
}

int checked_garment(int garment, int count) {
  if (garment < 0 || garment >= count) {
    throw std::out_of_range("garment " + std::to_string(garment) + " of " + std::to_string(count));
  }
  return garment;
}

// What keeps two layers in order; it reads arrays of the reader's.
LayerOrderData layer_order_data(PythonReader& reader, nb::handle order) {
  LayerOrderData data = read_layer_order(reader.fields_of(order));
  data.edge = nb::cast<float>(order.attr("edge"));
  return data;
}

// Garments that are evaluated together, and what keeps their order. They are packed while other Python threads run.
class BoundEvaluator {
 public:
  BoundEvaluator(const nb::list& garments, const nb::list& orders, const Text& instruction_set, const Text& precision)
      : evaluator_([&] {
          PythonReader reader;
          std::vector<BoundGarment> bound;
          for (nb::handle garment : garments) bound.push_back(reader.bound_garment(garment));
          const Kernels& kernels = select_kernels(instruction_set.value_or(""));
          const Precision chosen = select_precision(precision.value_or(""));
          const nb::gil_scoped_release release;
          return Evaluator(bound, kernels, chosen);
        }()) {
    PythonReader reader;
    for (nb::handle order : orders) {
      const LayerPair layers{nb::cast<int>(order.attr("steady")), nb::cast<int>(order.attr("yielding"))};
      evaluator_.keep_order(layers, layer_order_data(reader, order));
    }
  }

  Evaluator& evaluator() { return evaluator_; }
  const GarmentEvaluator& garment(int k) const { return evaluator_[checked_garment(k, evaluator_.count())]; }

 private:
  Evaluator evaluator_;
};

// A frame whose arrays were checked once: a call converts and allocates nothing. Keeps evaluator and arrays alive.
class BoundStep {
 public:
  BoundStep(nb::handle evaluator, Floats joint_positions, RowArray inputs, Outputs outs)
      : owner_(nb::borrow(evaluator)),
        evaluator_(nb::cast<BoundEvaluator&>(evaluator).evaluator()),
        joint_positions_(std::move(joint_positions)),
        inputs_(std::move(inputs)),
        outs_(std::move(outs)) {
    check_shape(joint_positions_, "joint_positions", {evaluator_.dofs()});
    check_shape(inputs_, "inputs", {evaluator_.count(), kGarmentInput});
    if (outs_.size() != std::size_t(evaluator_.count())) {
      throw std::invalid_argument("out has " + std::to_string(outs_.size()) + " arrays; expected one for each of " +
                                  std::to_string(evaluator_.count()) + " garments");
    }
    for (std::size_t k = 0; k < outs_.size(); ++k) {
      rows_.push_back(vertex_rows(outs_[k], evaluator_[int(k)].vertex_count()));
      if (rows_[k].with_normals != rows_[0].with_normals) {
        throw std::invalid_argument("arrays of out must all have normals, or none");
      }
    }
  }

  void step() {
    if (const Rejection bad = evaluator_.step(joint_positions_.data(), inputs(), rows_.data())) {
      const std::string garment =
          evaluator_.count() > 1 ? "garment " + std::to_string(evaluator_.rejected()) + ": " : "";
      throw std::invalid_argument(garment + bad.message());
    }
  }
  void pose() { evaluator_.pose(joint_positions_.data(), inputs()); }
  void run_networks() { evaluator_.run_networks(inputs()); }
  void compose_nodes() { evaluator_.compose_nodes(inputs()); }
  void skin() { evaluator_.skin(rows_.data()); }
  void keep() {
    if (rows_[0].with_normals) evaluator_.keep(rows_.data());
  }
  void compute_normals() { evaluator_.compute_normals(rows_.data()); }

 private:
  const GarmentInput* inputs() const { return reinterpret_cast<const GarmentInput*>(inputs_.data()); }

  nb::object owner_;
  Evaluator& evaluator_;
  Floats joint_positions_;
  RowArray inputs_;
  Outputs outs_;
  std::vector<VertexRows> rows_;
};

// Of two layers by themselves, as an outfit is bound.
class BoundLayerOrder {
 public:
  BoundLayerOrder(nb::handle order, int steady_vertices, int yielding_vertices)
      : order_([&] {
          PythonReader reader;
          const LayerOrderData data = layer_order_data(reader, order);
          const bool outside = nb::cast<int>(order.attr("yielding")) > nb::cast<int>(order.attr("steady"));
          return LayerOrder(data, outside ? Side::kOutside : Side::kInside, steady_vertices, yielding_vertices, arena_);
        }()),
        steady_(steady_vertices),
        yielding_(yielding_vertices) {}

  void apply(const OutputArray& steady, const OutputArray& yielding, bool look_at_all, float passed) {
    const VertexRows stays = vertex_rows(steady, steady_), moves = vertex_rows(yielding, yielding_);
    if (!stays.with_normals || !moves.with_normals) throw std::invalid_argument("both layers must have normals");
    order_.apply(stays, moves, look_at_all, passed);
  }

 private:
  Arena arena_;
  LayerOrder order_;
  int steady_, yielding_;
};

nb::ndarray<nb::numpy, const float, nb::shape<-1, 3, 4>> node_transforms(BoundEvaluator& self, int garment) {
  const GarmentEvaluator& of = self.garment(garment);
  return {of.node_transforms(), {std::size_t(of.nodes()), 3, 4}, nb::find(self)};
}

nb::ndarray<nb::numpy, const float, nb::shape<-1, 12>> corrections(BoundEvaluator& self, int garment) {
  const GarmentEvaluator& of = self.garment(garment);
  return {of.corrections(), {std::size_t(of.nodes()), 12}, nb::find(self)};
}

nb::ndarray<nb::numpy, const float, nb::shape<-1, 3>> detail_offsets(BoundEvaluator& self, int garment) {
  const GarmentEvaluator& of = self.garment(garment);
  return {of.detail_offsets(), {std::size_t(of.detail_nodes()), 3}, nb::find(self)};
}

void measure_clearance(BoundEvaluator& self, int garment, const WrittenFloats& out) {
  check_shape(out, "out", {self.garment(garment).clearances()});
  self.evaluator().measure_clearance(garment, out.data());
}

nb::dict stage_bytes(BoundEvaluator& self, int garment) {
  const StageBytes bytes = self.garment(garment).stage_bytes();
  nb::dict d;
  d["posing"] = bytes.posing;
  d["networks"] = bytes.networks;
  d["composition"] = bytes.composition;
  d["skinning"] = bytes.skinning;
  d["normals"] = bytes.normals;
  return d;
}

int clearances(BoundEvaluator& self, int garment) { return self.garment(garment).clearances(); }

nb::ndarray<nb::numpy, float, nb::shape<-1, kGarmentInput>, nb::c_contig> rows(FrameInput& self) {
  return {
      reinterpret_cast<float*>(self.rows()), {std::size_t(self.count()), std::size_t(kGarmentInput)}, nb::find(self)};
}

}  // namespace

void bind_frame(nb::module_& module) {
  nb::class_<BoundEvaluator>(module, "Evaluator")
      .def(nb::init<const nb::list&, const nb::list&, const Text&, const Text&>(), "garments"_a,
           "orders"_a = nb::list(), "instruction_set"_a = nb::none(), "precision"_a = nb::none())
      .def("node_transforms", node_transforms, "garment"_a = 0)
      .def("corrections", corrections, "garment"_a = 0)
      .def("detail_offsets", detail_offsets, "garment"_a = 0)
      .def("stage_bytes", stage_bytes, "garment"_a = 0)
      .def("clearances", clearances, "garment"_a = 0)
      .def("measure_clearance", measure_clearance, "garment"_a, "out"_a.noconvert())
      .def_prop_ro("instruction_set", [](BoundEvaluator& self) { return self.evaluator().instruction_set(); })
      .def_prop_ro("precision", [](BoundEvaluator& self) { return precision_name(self.evaluator().precision()); });
  nb::class_<BoundStep>(module, "Step")
      .def(nb::init<nb::handle, Floats, RowArray, Outputs>(), "evaluator"_a, "joint_positions"_a.noconvert(),
           "inputs"_a.noconvert(), "outs"_a.noconvert())
      .def("step", &BoundStep::step, "Computes one frame from what the bound input arrays hold now.")
      .def("pose", &BoundStep::pose)
      .def("run_networks", &BoundStep::run_networks)
      .def("compose_nodes", &BoundStep::compose_nodes)
      .def("skin", &BoundStep::skin)
      .def("keep", &BoundStep::keep)
      .def("compute_normals", &BoundStep::compute_normals);
  nb::class_<BoundLayerOrder>(module, "LayerOrder")
      .def(nb::init<nb::handle, int, int>(), "order"_a, "steady_vertices"_a, "yielding_vertices"_a)
      .def("apply", &BoundLayerOrder::apply, "steady"_a.noconvert(), "yielding"_a.noconvert(), "look_at_all"_a,
           "passed"_a = -1.0f);
  nb::class_<RootSample>(module, "RootSample").def_prop_ro("known", [](const RootSample& self) { return self.known; });
  nb::class_<RootTracker>(module, "RootTracker")
      .def(nb::init<>())
      .def("reset", &RootTracker::reset)
      .def(
          "move",
          [](RootTracker& self, double time, const Vector& root) {
            raise_if(self.move(time, vector_of(root, "root", 7)));
            return self.sample();
          },
          "time"_a, "root"_a);
  nb::class_<FrameInput>(module, "FrameInput")
      .def(nb::init<int>(), "garments"_a)
      .def(
          "set_sway",
          [](FrameInput& self, int garment, double amount) {
            self.set_sway(checked_garment(garment, self.count()), amount);
          },
          "garment"_a, "amount"_a)
      .def(
          "sway", [](FrameInput& self, int garment) { return self.sway(checked_garment(garment, self.count())); },
          "garment"_a)
      .def(
          "set_wind",
          [](FrameInput& self, const Vector& velocity) { raise_if(self.set_wind(vector_of(velocity, "wind", 3))); },
          "velocity"_a)
      .def("wind",
           [](const FrameInput& self) { return nb::make_tuple(self.wind()[0], self.wind()[1], self.wind()[2]); })
      .def("reset", &FrameInput::reset)
      .def(
          "hang",
          [](FrameInput& self, const Vector& direction) { raise_if(self.hang(vector_of(direction, "gravity", 3))); },
          "direction"_a)
      .def(
          "accelerate",
          [](FrameInput& self, const Vector& gravity, const std::optional<Vector>& at_rest) {
            const double* rest = at_rest ? vector_of(*at_rest, "at_rest", 3) : nullptr;
            raise_if(self.accelerate(vector_of(gravity, "effective_gravity", 3), rest));
          },
          "effective_gravity"_a, "at_rest"_a = nb::none())
      .def("follow", &FrameInput::follow, "root"_a)
      .def(
          "move",
          [](FrameInput& self, double time, const Vector& root) {
            raise_if(self.move(time, vector_of(root, "root", 7)));
          },
          "time"_a, "root"_a)
      .def(
          "begin_frame", [](FrameInput& self, double time) { raise_if(self.begin_frame(time)); }, "time"_a)
      .def("begin_still_frame", &FrameInput::begin_still_frame)
      .def_prop_ro("rows", rows);
}

}  // namespace physkin

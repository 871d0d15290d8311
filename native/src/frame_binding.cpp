// The part of physkin_core._native that computes frames: checks and converts, computes nothing.
#include "bindings.hpp"
#include "frame_input_binding.hpp"
#include "numpy_arrays.hpp"
#include "outfit/evaluator.hpp"
#include "python_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace physkin {
namespace {

using Outputs = std::vector<OutputArray>;

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

void check_output_count(std::size_t count, int garments) {
  if (count == std::size_t(garments)) return;
  throw std::invalid_argument("out has " + std::to_string(count) + " arrays; expected one for each of " +
                              std::to_string(garments) + " garments");
}

void check_normals(const std::vector<VertexRows>& rows) {
  for (const VertexRows& each : rows) {
    if (each.with_normals != rows[0].with_normals) {
      throw std::invalid_argument("arrays of out must all have normals, or none");
    }
  }
}

// Throws std::invalid_argument if an input or what the networks make of it is not finite.
void step(Evaluator& evaluator, const float* joint_positions, const GarmentInput* inputs, const VertexRows* rows) {
  if (const Rejection bad = evaluator.step(joint_positions, inputs, rows)) {
    const std::string garment = evaluator.count() > 1 ? "garment " + std::to_string(evaluator.rejected()) + ": " : "";
    throw std::invalid_argument(garment + bad.message());
  }
}

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
    check_output_count(outs_.size(), evaluator_.count());
    for (std::size_t k = 0; k < outs_.size(); ++k) {
      rows_.push_back(vertex_rows(outs_[k], evaluator_[int(k)].vertex_count()));
    }
    check_normals(rows_);
  }

  void step() { physkin::step(evaluator_, joint_positions_.data(), inputs(), rows_.data()); }
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

// Frames whose arrays may be others in each: one call does all of a frame. Keeps evaluator and frame input alive.
class BoundFrames {
 public:
  BoundFrames(nb::handle evaluator, nb::handle frame_input, Floats rest, nb::dict joint_indices)
      : evaluator_owner_(nb::borrow(evaluator)),
        input_owner_(nb::borrow(frame_input)),
        evaluator_(nb::cast<BoundEvaluator&>(evaluator).evaluator()),
        input_(nb::cast<FrameInput&>(frame_input)),
        rest_(std::move(rest)),
        joint_indices_(std::move(joint_indices)),
        positions_(std::size_t(evaluator_.dofs())) {
    check_shape(rest_, "rest", {evaluator_.dofs()});
    if (input_.count() != evaluator_.count()) {
      throw std::invalid_argument("there are inputs for " + std::to_string(input_.count()) + " of " +
                                  std::to_string(evaluator_.count()) + " garments");
    }
    for (int k = 0; k < evaluator_.count(); ++k) {
      shapes_.push_back(nb::make_tuple(evaluator_[k].vertex_count(), 6));
    }
  }

  // See Evaluator.frames in evaluator.py.
  nb::object drape(nb::handle joint_positions, nb::handle look_at_unusual, nb::handle gravity,
                   nb::handle effective_gravity, nb::handle time, nb::handle root, nb::handle outs) {
    take_positions(joint_positions, look_at_unusual);
    const nb::list clouds = outs.is_none() ? new_clouds() : nb::list(outs);
    std::vector<OutputArray> held;
    take_outputs(clouds, held);
    fill(input_, gravity, effective_gravity, time, root);
    step(evaluator_, positions_.data(), input_.rows(), rows_.data());
    return clouds;
  }

 private:
  void take_positions(nb::handle given, nb::handle look_at_unusual) {
    if (read_named(given) || read_row(given, positions_.size(), positions_.data())) {
      float sum = 0;
      for (float position : positions_) sum += position * position;
      if (sum <= kFullTurn * kFullTurn) return;  // the cheapest question that all usual poses pass, and no NaN
    }
    if (!read_row(look_at_unusual(given), positions_.size(), positions_.data())) {
      throw std::invalid_argument("joint_positions must have shape " + shape_text({evaluator_.dofs()}));
    }
  }

  // Positions by joint name, the others being at rest. False if this is no dictionary, or has what cannot be taken.
  bool read_named(nb::handle given) {
    if (!PyDict_Check(given.ptr()) || joint_indices_.size() == 0) return false;
    std::copy_n(rest_.data(), positions_.size(), positions_.begin());
    PyObject *name, *value;
    for (Py_ssize_t at = 0; PyDict_Next(given.ptr(), &at, &name, &value);) {
      PyObject* joint = PyDict_GetItem(joint_indices_.ptr(), name);  // null without an error
      if (joint == nullptr) return false;
      const nb::object held = nb::borrow(value);  // while code of its own may run
      const double position = PyFloat_AsDouble(value);
      if (position == -1 && PyErr_Occurred() != nullptr) {
        PyErr_Clear();
        return false;
      }
      positions_.at(PyLong_AsSize_t(joint)) = float(position);
    }
    return true;
  }

  nb::list new_clouds() const {
    const Numpy& numpy = Numpy::get();
    nb::list clouds;
    for (const nb::object& shape : shapes_) clouds.append(numpy.empty(shape, numpy.float32));
    return clouds;
  }

  // held: as of given_rows.
  void take_outputs(const nb::list& outs, std::vector<OutputArray>& held) {
    check_output_count(outs.size(), evaluator_.count());
    rows_.clear();
    for (int k = 0; k < evaluator_.count(); ++k) {
      rows_.push_back(given_rows(outs[std::size_t(k)], evaluator_[k].vertex_count(), held));
    }
    check_normals(rows_);
  }

  static constexpr float kFullTurn = 6.2831853f;  // [rad]

  nb::object evaluator_owner_, input_owner_;
  Evaluator& evaluator_;
  FrameInput& input_;
  Floats rest_;
  nb::dict joint_indices_;
  std::vector<nb::object> shapes_;
  std::vector<float> positions_;
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

}  // namespace

void bind_frame(nb::module_& module) {
  nb::class_<BoundEvaluator>(module, "Evaluator")
      .def(nb::init<const nb::list&, const nb::list&, const Text&, const Text&>(), "garments"_a,
           "orders"_a = nb::list(), "instruction_set"_a = nb::none(), "precision"_a = nb::none())
      .def("forget", [](BoundEvaluator& self) { self.evaluator().forget(); })
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
  nb::class_<BoundFrames>(module, "Frames")
      .def(nb::init<nb::handle, nb::handle, Floats, nb::dict>(), "evaluator"_a, "frame_input"_a, "rest"_a.noconvert(),
           "joint_indices"_a)
      .def("drape", &BoundFrames::drape, "joint_positions"_a, "look_at_unusual"_a, "gravity"_a,
           "effective_gravity"_a.none(), "time"_a.none(), "root"_a.none(), "outs"_a.none());
  nb::class_<BoundLayerOrder>(module, "LayerOrder")
      .def(nb::init<nb::handle, int, int>(), "order"_a, "steady_vertices"_a, "yielding_vertices"_a)
      .def("apply", &BoundLayerOrder::apply, "steady"_a.noconvert(), "yielding"_a.noconvert(), "look_at_all"_a,
           "passed"_a = -1.0f);
}

}  // namespace physkin

// physkin_core._native: checks and converts, computes nothing.
#include "evaluator/body_encoder.hpp"
#include "evaluator/evaluator_batch.hpp"
#include "evaluator/skinner.hpp"
#include "kernels/machine_floors.hpp"
#include "joints_binding.hpp"
#include "motion_binding.hpp"
#include "outfit_binding.hpp"
#include "python_arrays.hpp"
#include "separation_binding.hpp"
#include "sway_binding.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace physkin {
namespace {

DenseWeights named_layer(const nb::dict& network, const std::string& name) {
  const std::string weight = name + ".weight", bias = name + ".bias";
  const nb::object matrix = network[weight.c_str()], offset = network[bias.c_str()];
  return dense_weights(matrix, weight, offset, bias);
}

LayerNorm named_norm(const nb::dict& network, const std::string& name) {
  const std::string weight = name + ".weight", bias = name + ".bias";
  std::vector<int> shape{-1};
  const float* values = view<float>(network[weight.c_str()], weight, shape);
  return {shape[0], values, view<float>(network[bias.c_str()], bias, shape)};
}

BodyEncoder body_encoder(const nb::dict& network) {
  BodyEncoder e;
  e.embed = named_layer(network, "embed");
  e.attention_input = named_layer(network, "attention.input");
  e.attention_output = named_layer(network, "attention.output");
  e.norm_1 = named_norm(network, "norm_1");
  e.norm_2 = named_norm(network, "norm_2");
  e.feed_forward_0 = named_layer(network, "feed_forward.0");
  e.feed_forward_1 = named_layer(network, "feed_forward.1");
  e.pool = named_layer(network, "pool");
  for (std::string block = "residual.0"; network.contains((block + ".norm.weight").c_str());
       block = "residual." + std::to_string(e.residual.size())) {
    e.residual.push_back({named_norm(network, block + ".norm"), named_layer(network, block + ".0"),
                          named_layer(network, block + ".1")});
  }
  e.output = named_layer(network, "output");
  return e;
}

// Without the interpreter's lock: `network` is the caller's own, nobody else takes arrays out of it.
void encode(const nb::dict& network, nb::handle points, nb::handle normals,
            const nb::ndarray<float, nb::ndim<1>, nb::c_contig, nb::device::cpu>& out,
            const std::optional<std::string>& instruction_set) {
  const BodyEncoder encoder = body_encoder(network);
  std::vector<int> shape{-1, 3};
  const float* at = view<float>(points, "points", shape);
  const float* normal = view<float>(normals, "normals", shape);
  check_shape(out, "out", {encoder.output.outputs});
  const Kernels& kernels = select_kernels(instruction_set.value_or(""));
  const nb::gil_scoped_release release;
  encode_body(encoder, kernels, at, normal, shape[0], out.data());
}

using TransformArray = nb::ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

// A garment without its networks.
class BoundSkinner {
 public:
  explicit BoundSkinner(nb::handle skinning_data) : skinner_([&] {
          PythonReader reader;
          const SkinningData data = reader.skinning_data(skinning_data);
          const Kernels& kernels = select_kernels();
          const nb::gil_scoped_release release;
          validate(data);
          return Skinner(data, kernels, arena_);
        }()) {}

  void skin(const TransformArray& node_transforms, const OutputArray& out) {
    check_shape(node_transforms, "node_transforms", {skinner_.nodes(), 3, 4});
    const VertexRows rows = vertex_rows(out, skinner_.vertex_count());
    raise_if(skinner_.check(node_transforms.data()));
    skinner_.skin(node_transforms.data(), rows);
  }

 private:
  Arena arena_;
  Skinner skinner_;
};

// The evaluator with room for its converted inputs.
class BoundEvaluator {
 public:
  BoundEvaluator(nb::handle garment, const Text& instruction_set, const Text& precision, const std::string& normals)
      : evaluator_([&] {
          PythonReader reader;
          const BoundGarment bound = reader.bound_garment(garment);
          const Kernels& kernels = select_kernels(instruction_set.value_or(""));
          const EvaluatorOptions options = evaluator_options(precision, normals);
          const nb::gil_scoped_release release;
          return Evaluator(bound, kernels, options);
        }()),
        joint_positions_(evaluator_.dofs()) {}

  void evaluate(const AnyArray& joint_positions, const AnyArray& gravity, const OutputArray& out) {
    read_vector(joint_positions, "joint_positions", evaluator_.dofs(), joint_positions_.data());
    const int size = gravity_size(gravity);
    read_vector(gravity, "gravity", size, gravity_);
    const VertexRows rows = vertex_rows(out, evaluator_.vertex_count());
    step_under(evaluator_, joint_positions_.data(), gravity_, size, rows);
  }

  void skin(const TransformArray& node_transforms, const OutputArray& out) {
    check_shape(node_transforms, "node_transforms", {evaluator_.nodes(), 3, 4});
    raise_if(evaluator_.skin(node_transforms.data(), vertex_rows(out, evaluator_.vertex_count())));
  }

  Evaluator& evaluator() { return evaluator_; }
  const Evaluator& evaluator() const { return evaluator_; }

 private:
  Evaluator evaluator_;
  std::vector<float> joint_positions_;
  float gravity_[kGravityAndMoment] = {};
};

// A frame whose arrays were checked once: a call converts and allocates nothing. Keeps evaluator and arrays alive.
class BoundStep {
 public:
  using InputArray = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

  BoundStep(nb::handle evaluator, InputArray joint_positions, InputArray gravity, OutputArray out)
      : owner_(nb::borrow(evaluator)),
        evaluator_(nb::cast<BoundEvaluator&>(evaluator).evaluator()),
        joint_positions_(std::move(joint_positions)),
        gravity_(std::move(gravity)),
        out_(std::move(out)),
        rows_(vertex_rows(out_, evaluator_.vertex_count())) {
    check_shape(joint_positions_, "joint_positions", {evaluator_.dofs()});
    check_shape(gravity_, "gravity", {gravity_size(gravity_)});
  }

  void step() {
    step_under(evaluator_, joint_positions_.data(), gravity_.data(), gravity_size(gravity_), rows_);
  }
  void pose() { evaluator_.pose(joint_positions_.data(), gravity_.data()); }
  void run_networks() { evaluator_.run_networks(); }
  void compose_nodes() { evaluator_.compose_nodes(evaluator_.corrections()); }
  void skin() { raise_if(evaluator_.skin(evaluator_.node_transforms(), rows_)); }
  void compute_normals() { evaluator_.compute_normals(rows_); }

 private:
  nb::object owner_;
  Evaluator& evaluator_;
  InputArray joint_positions_, gravity_;
  OutputArray out_;
  VertexRows rows_;
};

// Frames of several bodies with arrays that were checked once; keeps the arrays alive.
class BoundBatch {
 public:
  using InputArray = nb::ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
  using OutputArrays = nb::ndarray<float, nb::ndim<3>, nb::device::cpu>;

  BoundBatch(const nb::list& garments, const Text& instruction_set, const Text& precision, const std::string& normals)
      : batch_(evaluator_of<EvaluatorBatch>(garments, instruction_set, precision, normals)),
        rows_(std::size_t(batch_.count())) {}

  void bind(InputArray joint_positions, InputArray gravity, OutputArrays out) {
    check_shape(joint_positions, "joint_positions", {batch_.count(), batch_[0].dofs()});
    check_shape(gravity, "gravity", {batch_.count(), 3});
    check_shape(out, "out", {batch_.count(), batch_[0].vertex_count(), out.shape(2) == 3 ? 3 : 6});
    std::vector<VertexRows> rows;
    for (std::size_t k = 0; k < out.shape(0); ++k) {
      const std::size_t shape[2] = {out.shape(1), out.shape(2)};
      const std::int64_t strides[2] = {out.stride(1), out.stride(2)};
      rows.push_back(vertex_rows(OutputArray(out.data() + std::int64_t(k) * out.stride(0), 2, shape, {}, strides),
                                 batch_[0].vertex_count()));
    }
    const std::int64_t body = std::abs(out.stride(0));
    const std::int64_t row = std::abs(out.stride(1)), columns = std::int64_t(out.shape(2));
    // Bodies one after the other, or rows of the bodies in turns.
    const bool apart = body >= row * (std::int64_t(out.shape(1)) - 1) + columns;
    const bool in_turns = body >= columns && row >= body * (batch_.count() - 1) + columns;
    if (batch_.count() > 1 && !apart && !in_turns) {
      throw nb::value_error(("bodies of out overlap: they are " + std::to_string(out.stride(0)) + " floats apart").c_str());
    }
    rows_ = rows;
    joint_positions_ = std::move(joint_positions);
    gravity_ = std::move(gravity);
    out_ = std::move(out);
  }

  void step() {
    if (!out_.is_valid()) throw nb::value_error("the batch has no arrays yet: bind them first");
    if (const Rejection bad = batch_.step(joint_positions_.data(), gravity_.data(), rows_.data())) {
      throw nb::value_error(("body " + std::to_string(batch_.rejected()) + ": " + bad.message()).c_str());
    }
  }

  const EvaluatorBatch& batch() const { return batch_; }

 private:
  EvaluatorBatch batch_;
  std::vector<VertexRows> rows_;
  InputArray joint_positions_, gravity_;
  OutputArrays out_;
};

nb::ndarray<nb::numpy, const float, nb::shape<-1, -1>> corrections(const BoundEvaluator& self) {
  const Evaluator& evaluator = self.evaluator();
  return {evaluator.corrections(), {std::size_t(evaluator.nodes()), std::size_t(evaluator.correction_size())},
          nb::find(self)};
}

}  // namespace
}  // namespace physkin

NB_MODULE(_native, module) {
  using physkin::BoundBatch;
  using physkin::BoundEvaluator;
  using physkin::BoundSkinner;
  using physkin::BoundStep;
  using physkin::MachineProbe;
  using physkin::Text;
  nb::class_<BoundEvaluator>(module, "Evaluator")
      .def(nb::init<nb::handle, const Text&, const Text&, const std::string&>(), "garment"_a,
           "instruction_set"_a = nb::none(), "precision"_a = nb::none(), "normals"_a = "skinned")
      .def("evaluate", &BoundEvaluator::evaluate, "joint_positions"_a.noconvert(), "gravity"_a.noconvert(),
           "out"_a.noconvert())
      .def("skin", &BoundEvaluator::skin, "node_transforms"_a.noconvert(), "out"_a.noconvert())
      .def_prop_ro("node_transforms",
                   [](const BoundEvaluator& self) {
                     const std::size_t nodes = std::size_t(self.evaluator().nodes());
                     return nb::ndarray<nb::numpy, const float, nb::shape<-1, 3, 4>>(
                         self.evaluator().node_transforms(), {nodes, 3, 4}, nb::find(self));
                   })
      .def_prop_ro("corrections", physkin::corrections)
      .def_prop_ro("instruction_set", [](const BoundEvaluator& self) { return self.evaluator().instruction_set(); })
      .def_prop_ro("precision", [](const BoundEvaluator& self) { return precision_name(self.evaluator().precision()); })
      .def_prop_ro("skinning_terms", [](const BoundEvaluator& self) { return self.evaluator().skinning_terms(); });
  nb::class_<BoundSkinner>(module, "Skinner")
      .def(nb::init<nb::handle>(), "skinning_data"_a)
      .def("skin", &BoundSkinner::skin, "node_transforms"_a.noconvert(), "out"_a.noconvert());
  nb::class_<BoundStep>(module, "Step")
      .def(nb::init<nb::handle, BoundStep::InputArray, BoundStep::InputArray, physkin::OutputArray>(), "evaluator"_a,
           "joint_positions"_a.noconvert(), "gravity"_a.noconvert(), "out"_a.noconvert())
      .def("step", &BoundStep::step, "Computes one frame from what the bound input arrays hold now.")
      .def("pose", &BoundStep::pose)
      .def("run_networks", &BoundStep::run_networks)
      .def("compose_nodes", &BoundStep::compose_nodes)
      .def("skin", &BoundStep::skin)
      .def("compute_normals", &BoundStep::compute_normals);
  nb::class_<BoundBatch>(module, "Batch")
      .def(nb::init<const nb::list&, const Text&, const Text&, const std::string&>(), "garments"_a,
           "instruction_set"_a = nb::none(), "precision"_a = nb::none(), "normals"_a = "skinned")
      .def("bind", &BoundBatch::bind, "joint_positions"_a.noconvert(), "gravity"_a.noconvert(), "out"_a.noconvert())
      .def("step", &BoundBatch::step, "Computes a frame of every body from what the bound input arrays hold now.")
      .def_prop_ro("instruction_set", [](const BoundBatch& self) { return self.batch()[0].instruction_set(); })
      .def_prop_ro("precision", [](const BoundBatch& self) { return precision_name(self.batch()[0].precision()); });
  module.def("encode_body", &physkin::encode, "network"_a, "points"_a, "normals"_a, "out"_a.noconvert(),
             "instruction_set"_a = nb::none());
  module.def("bound_garment_fields", physkin::bound_garment_fields);
  module.def("supported_instruction_sets", physkin::supported_instruction_sets);
  physkin::bind_joints(module);
  physkin::bind_motion(module);
  physkin::bind_outfit(module);
  physkin::bind_separation(module);
  physkin::bind_sway(module);
  nb::class_<MachineProbe>(module, "MachineProbe")
      .def("__init__",
           [](MachineProbe* self, std::int64_t bytes, const Text& instruction_set) {
             new (self) MachineProbe(physkin::select_kernels(instruction_set.value_or("")), bytes);
           },
           "bytes"_a, "instruction_set"_a = nb::none())
      .def("read", &MachineProbe::read, "fetch_ahead"_a)
      .def("multiply_add", &MachineProbe::multiply_add, "rounds"_a);
}

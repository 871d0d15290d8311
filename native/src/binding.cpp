// physkin_core._native: checks and converts, computes nothing.
#include "bindings.hpp"
#include "evaluator/body_encoder.hpp"
#include "evaluator/skinner.hpp"
#include "garment/spread_points.hpp"
#include "outfit/evaluator.hpp"
#include "python_arrays.hpp"
#include "separation/limb_separator.hpp"
#include "sway/frame_input.hpp"

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
    e.residual.push_back(
        {named_norm(network, block + ".norm"), named_layer(network, block + ".0"), named_layer(network, block + ".1")});
  }
  e.output = named_layer(network, "output");
  return e;
}

// Without the interpreter's lock: `network` is the caller's own, nobody else takes arrays out of it.
void encode(const nb::dict& network, nb::handle points, nb::handle normals, const WrittenFloats& out,
            const Text& instruction_set) {
  const BodyEncoder encoder = body_encoder(network);
  std::vector<int> shape{-1, 3};
  const float* at = view<float>(points, "points", shape);
  const float* normal = view<float>(normals, "normals", shape);
  check_shape(out, "out", {encoder.output.outputs});
  const Kernels& kernels = select_kernels(instruction_set.value_or(""));
  const nb::gil_scoped_release release;
  encode_body(encoder, kernels, at, normal, shape[0], out.data());
}

using Points = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Indices = nb::ndarray<std::int32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

void spread(const Points& points, const Indices& chosen) {
  if (points.shape(0) < chosen.shape(0)) throw std::invalid_argument("more points are to be chosen than there are");
  const nb::gil_scoped_release release;
  spread_points(points.data(), int(points.shape(0)), int(points.shape(1)), chosen.data(), int(chosen.shape(0)));
}

using TransformArray = nb::ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

// A garment without its networks.
class BoundSkinner {
 public:
  explicit BoundSkinner(nb::handle skinning_data)
      : skinner_([&] {
          PythonReader reader;
          const SkinningData data = reader.skinning_data(skinning_data);
          const Kernels& kernels = select_kernels();
          const nb::gil_scoped_release release;
          validate(data);
          return Skinner(data, kernels, arena_);
        }()) {}

  void skin(const TransformArray& node_transforms, const OutputArray& out, const RowArray& detail_offsets) {
    check_shape(node_transforms, "node_transforms", {skinner_.nodes(), 3, 4});
    check_shape(detail_offsets, "detail_offsets", {skinner_.detail_nodes(), 3});
    const VertexRows rows = vertex_rows(out, skinner_.vertex_count());
    raise_if(skinner_.check(node_transforms.data()));
    raise_if(skinner_.check_offsets(detail_offsets.data()));
    skinner_.skin(node_transforms.data(), detail_offsets.data(), rows);
    skinner_.compute_normals(rows);
  }

 private:
  Arena arena_;
  Skinner skinner_;
};

// (name, type, whether its rows are vertices) of every field of a bound garment.
nb::list described_fields() {
  nb::list fields;
  for (const FieldDescription& field : bound_garment_fields()) {
    fields.append(nb::make_tuple(field.name, field.type, field.per_vertex));
  }
  return fields;
}

// Numbers that Python reads, too: they are written once, in C++.
nb::dict constants() {
  nb::dict d;
  d["standard_gravity"] = kStandardGravity;
  d["largest_effective_gravity"] = kLargestEffectiveGravity;
  d["air_drag"] = kAirDrag;
  d["largest_wind"] = kLargestWind;
  d["joints_beyond"] = kBeyond;
  d["largest_rate"] = kLargestRate;
  d["largest_velocity"] = kLargestVelocity;
  d["largest_turning"] = kLargestTurning;
  d["most_speed_up"] = kMostSpeedUp;
  d["deepest"] = kDeepest;
  d["encoding_frequencies"] = kEncodingFrequencies;
  d["heads"] = kHeads;
  d["capsule_blur"] = kCapsuleBlur;
  d["bound_file_version"] = kBoundFileVersion;
  d["block"] = kBlock;
  d["skin_block"] = kSkinBlock;
  d["soft"] = Contact::kSoft;
  d["turns"] = kTurns;
  d["beside"] = kBeside;
  return d;
}

}  // namespace
}  // namespace physkin

NB_MODULE(_native, module) {
  nb::set_leak_warnings(false);  // a bound frame that a script keeps until the interpreter ends is none
  using physkin::BoundSkinner;
  using physkin::Text;
  nb::class_<BoundSkinner>(module, "Skinner")
      .def(nb::init<nb::handle>(), "skinning_data"_a)
      .def("skin", &BoundSkinner::skin, "node_transforms"_a.noconvert(), "out"_a.noconvert(),
           "detail_offsets"_a.noconvert());
  module.def("encode_body", &physkin::encode, "network"_a, "points"_a, "normals"_a, "out"_a.noconvert(),
             "instruction_set"_a = nb::none());
  module.def("spread_points", physkin::spread, "points"_a.noconvert(), "chosen"_a.noconvert());
  module.def("bound_garment_fields", physkin::described_fields);
  module.attr("constants") = physkin::constants();
  module.def("supported_instruction_sets", physkin::supported_instruction_sets);
  physkin::bind_frame_input(module);  // before what takes them
  physkin::bind_frame(module);
  physkin::bind_joints(module);
  physkin::bind_separation(module);
}

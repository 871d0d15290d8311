#include "file_format/bound_file.hpp"

#include <cstring>

#include "file_format/tensor_file.hpp"

namespace physkin {
namespace {

constexpr char kFormat[] = "physkin-bound-garment";

// More garments than one has on.
constexpr std::size_t kMostGarments = 16;

// The fields of one garment, or of one order of two, whose names in the file begin with `prefix`; arrays are copied into
// one arena.
class FileFields : public FieldSource {
 public:
  FileFields(TensorFile& file, std::string prefix, Arena& arena)
      : file_(file), prefix_(std::move(prefix)), arena_(arena) {}

  const float* floats(const std::string& name, std::vector<int>& shape) override {
    const std::string at = prefix_ + name;
    return file_.holds_steps(at) ? in_steps(at, shape) : copied<float>(at, "F32", shape);
  }
  const std::int32_t* integers(const std::string& name, std::vector<int>& shape) override {
    return copied<std::int32_t>(prefix_ + name, "I32", shape);
  }
  std::vector<DenseWeights> layers(const std::string& name) override {
    std::vector<DenseWeights> layers;
    for (std::string at = name + ".0"; file_.contains(prefix_ + at + ".weight");
         at = name + "." + std::to_string(layers.size())) {
      std::vector<int> shape{-1, -1};
      const float* matrix = floats(at + ".weight", shape);
      std::vector<int> outputs{shape[0]};
      layers.push_back({shape[0], shape[1], matrix, floats(at + ".bias", outputs)});
    }
    return layers;
  }

 private:
  template <class T>
  T* copied(const std::string& name, const char* type, std::vector<int>& shape) {
    const unsigned char* numbers = file_.numbers(name, type, shape);
    T* copy = arena_.take<T>(count(shape));
    if (count(shape) > 0) std::memcpy(copy, numbers, sizeof(T) * count(shape));
    return copy;
  }

  // Rows of whole steps, each row with a step of its own.
  const float* in_steps(const std::string& name, std::vector<int>& shape) {
    const auto* steps = reinterpret_cast<const signed char*>(file_.numbers(name, "I8", shape));
    std::vector<int> rows{shape[0], 1};
    const float* step = copied<float>(name + ".step", "F32", rows);
    float* values = arena_.take<float>(count(shape));
    const std::size_t width = shape[0] > 0 ? count(shape) / std::size_t(shape[0]) : 0;
    for (std::size_t at = 0; at < count(shape); ++at) values[at] = step[at / width] * float(steps[at]);
    return values;
  }

  static std::size_t count(const std::vector<int>& shape) {
    std::size_t product = 1;
    for (int size : shape) product *= std::size_t(size);
    return product;
  }

  TensorFile& file_;
  std::string prefix_;
  Arena& arena_;
};

BoundOrder read_order(TensorFile& file, const std::string& prefix, int garments, Arena& arena) {
  FileFields fields(file, prefix, arena);
  std::vector<int> two{2}, one{1};
  const std::int32_t* layers = fields.integers("layers", two);
  for (int k = 0; k < 2; ++k) {
    if (layers[k] < 0 || layers[k] >= garments) {
      throw FileError(prefix + "layers[" + std::to_string(k) + "] is " + std::to_string(layers[k]) +
                      "; must be in [0, " + std::to_string(garments) + ")");
    }
  }
  const float edge = *fields.floats("edge", one);
  if (!(edge > 0 && edge < 1))
    throw FileError(prefix + "edge is " + std::to_string(edge) + " m; must be above 0, below 1");
  BoundOrder order{layers[0], layers[1], read_layer_order(fields)};
  order.data.edge = edge;
  return order;
}

}  // namespace

BoundFile::BoundFile(const unsigned char* data, std::size_t size) {
  TensorFile file(data, size);
  if (file.metadata("format") != kFormat) {
    throw FileError("the file is of format '" + shown(file.metadata("format")) + "'; expected " + kFormat +
                    ", as `physkin bind` writes it");
  }
  if (file.metadata("schema_version") != kBoundGarmentVersion) {
    throw FileError("the file has schema version '" + shown(file.metadata("schema_version")) +
                    "'; this library reads " + kBoundGarmentVersion + ", which `physkin bind` writes");
  }
  if (file.metadata(kDigest) != file.digest()) {
    throw FileError("the file is damaged or was altered: its SHA-256 digest does not match; `physkin bind` it anew");
  }
  garment_names = parse_string_list(file.metadata("garments"));
  if (garment_names.empty() || garment_names.size() > kMostGarments) {
    throw FileError("the file names " + std::to_string(garment_names.size()) + " garments; expected 1 to " +
                    std::to_string(kMostGarments));
  }
  for (std::size_t k = 0; k < garment_names.size(); ++k) {
    const std::string prefix = k == 0 ? "" : std::to_string(k) + ".";
    FileFields fields(file, prefix, arena);
    garments.push_back(read_bound_garment(fields));
    fabric_names.push_back(parse_string_list(file.metadata(prefix + "fabrics")));
    if (fabric_names.back().size() != 1 + std::size_t(garments.back().fabrics)) {
      throw FileError("the file names " + std::to_string(fabric_names.back().size()) +
                      " fabrics of a garment; expected " + std::to_string(1 + garments.back().fabrics));
    }
  }
  for (std::string at = "order.0."; file.contains(at + "layers"); at = "order." + std::to_string(orders.size()) + ".") {
    orders.push_back(read_order(file, at, int(garments.size()), arena));
  }
  joint_names = parse_string_list(file.metadata("joint_names"));
  if (joint_names.size() != std::size_t(garments.front().dofs)) {
    throw FileError("the file names " + std::to_string(joint_names.size()) + " joints; expected " +
                    std::to_string(garments.front().dofs));
  }
  file.refuse_unread();
}

}  // namespace physkin

#include "file_format/bound_file.hpp"

#include <cstring>

#include "file_format/tensor_file.hpp"

namespace physkin {
namespace {

constexpr char kFormat[] = "physkin-bound-garment";

// The fields of one file, its arrays copied into one arena.
class FileFields : public FieldSource {
 public:
  FileFields(TensorFile& file, Arena& arena) : file_(file), arena_(arena) {}

  const float* floats(const std::string& name, std::vector<int>& shape) override {
    return copied<float>(name, "F32", shape);
  }
  const std::int32_t* integers(const std::string& name, std::vector<int>& shape) override {
    return copied<std::int32_t>(name, "I32", shape);
  }
  std::vector<DenseWeights> layers(const std::string& name) override {
    std::vector<DenseWeights> layers;
    for (std::string at = name + ".0"; file_.contains(at + ".weight");
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
  const T* copied(const std::string& name, const char* type, std::vector<int>& shape) {
    const unsigned char* numbers = file_.numbers(name, type, shape);
    std::size_t count = 1;
    for (int size : shape) count *= std::size_t(size);
    T* copy = arena_.take<T>(count);
    if (count > 0) std::memcpy(copy, numbers, sizeof(T) * count);
    return copy;
  }

  TensorFile& file_;
  Arena& arena_;
};

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
  FileFields fields(file, arena);
  garment = read_bound_garment(fields);
  joint_names = parse_string_list(file.metadata("joint_names"));
  if (joint_names.size() != std::size_t(garment.dofs)) {
    throw FileError("the file names " + std::to_string(joint_names.size()) + " joints; expected " +
                    std::to_string(garment.dofs));
  }
  file.refuse_unread();
}

}  // namespace physkin

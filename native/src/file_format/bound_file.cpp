#include "file_format/bound_file.hpp"

#include <algorithm>
#include <array>
#include <cstring>

namespace physkin {
namespace {

constexpr char kMagic[] = "PhySkin\n";
constexpr std::size_t kHeader = 16;  // [bytes]
// More garments than one has on, and orders of two.
constexpr std::uint32_t kMostGarments = 16, kMostOrders = kMostGarments * kMostGarments;
// No dimension of a garment comes near, and products with the handful of numbers an element has fit an int.
constexpr std::uint32_t kLargestSize = 1 << 24;

// Of arrays.
enum : std::uint32_t { kFloats, kIntegers, kSteps };

// As of zlib.
std::uint32_t crc32(const unsigned char* data, std::size_t size) {
  std::array<std::uint32_t, 256> table;
  for (std::uint32_t byte = 0; byte < 256; ++byte) {
    table[byte] = byte;
    for (int bit = 0; bit < 8; ++bit) table[byte] = table[byte] >> 1 ^ (table[byte] & 1 ? 0xedb88320u : 0);
  }
  std::uint32_t sum = ~0u;
  for (std::size_t at = 0; at < size; ++at) sum = sum >> 8 ^ table[(sum ^ data[at]) & 0xff];
  return ~sum;
}

// The numbers and texts of a file, one behind the other. What would lie behind its end is refused, by the name of what is
// read.
class Cursor {
 public:
  Cursor(const unsigned char* data, std::size_t size) : at_(data), left_(size) {}

  const unsigned char* take(std::uint64_t bytes, const std::string& name) {
    if (bytes > left_) throw FileError("the file ends within " + name + "; it is cut off or damaged");
    const unsigned char* taken = at_;
    at_ += bytes;
    left_ -= std::size_t(bytes);
    return taken;
  }
  template <class Number>
  Number number(const std::string& name) {
    Number value;
    std::memcpy(&value, take(sizeof value, name), sizeof value);
    return value;
  }
  std::uint32_t number(const std::string& name, std::uint32_t least, std::uint32_t most) {
    const auto found = number<std::uint32_t>(name);
    if (found >= least && found <= most) return found;
    throw FileError("the file holds " + std::to_string(found) + " for " + name + "; allowed: " + std::to_string(least) +
                    " to " + std::to_string(most));
  }
  std::string text(const std::string& name) {
    const std::uint32_t length = number("the length of " + name, 0, kLargestSize);
    return {reinterpret_cast<const char*>(take(length, name)), length};
  }
  std::vector<std::string> texts(const std::string& name) {
    std::vector<std::string> found;
    for (auto left = number("the number of " + name, 0, kLargestSize); left > 0; --left) found.push_back(text(name));
    return found;
  }
  bool at_end() const { return left_ == 0; }

 private:
  const unsigned char* at_;
  std::size_t left_;
};

// The fields of one garment, or of one order of two, in the order that they are asked for. Arrays are copied into one
// arena.
class FileFields : public FieldSource {
 public:
  FileFields(Cursor& cursor, std::string of, Arena& arena) : cursor_(cursor), of_(std::move(of)), arena_(arena) {}

  const float* floats(const std::string& name, std::vector<int>& shape) override {
    const bool in_steps = kind(name) == kSteps;
    const std::size_t count = sized(name, shape);
    if (!in_steps) return copied<float>(name, count);
    // Rows of whole steps, each row with a step of its own.
    const float* step = copied<float>(name, std::size_t(shape[0]));
    const auto* steps = reinterpret_cast<const signed char*>(cursor_.take(count, name + of_));
    float* values = arena_.take<float>(count);
    const std::size_t width = shape[0] > 0 ? count / std::size_t(shape[0]) : 0;
    for (std::size_t at = 0; at < count; ++at) values[at] = step[at / width] * float(steps[at]);
    return values;
  }
  const std::int32_t* integers(const std::string& name, std::vector<int>& shape) override {
    if (kind(name) != kIntegers) throw FileError(name + of_ + " are not integers; the file is damaged");
    return copied<std::int32_t>(name, sized(name, shape));
  }
  std::vector<DenseWeights> layers(const std::string& name) override {
    std::vector<DenseWeights> layers(cursor_.number("the number of " + name + of_, 0, kMostLayers));
    for (DenseWeights& layer : layers) {
      std::vector<int> shape{-1, -1};
      layer.matrix = floats(name, shape);
      layer.outputs = shape[0];
      layer.inputs = shape[1];
      std::vector<int> outputs{-1};
      layer.bias = floats(name, outputs);
      if (outputs[0] == 0 && layer.outputs > 0) {
        layer.bias = nullptr;  // a projection
      } else if (outputs[0] != layer.outputs) {
        throw FileError("a bias of " + name + of_ + " has " + std::to_string(outputs[0]) + " values; expected " +
                        std::to_string(layer.outputs) + ", or none; the file is damaged");
      }
    }
    return layers;
  }

 private:
  static constexpr std::uint32_t kMostLayers = 64;

  std::uint32_t kind(const std::string& name) { return cursor_.number("the kind of " + name + of_, kFloats, kSteps); }

  // Reads the size of each axis, which is that in `shape` where it is not negative there. Returns how many numbers follow.
  std::size_t sized(const std::string& name, std::vector<int>& shape) {
    std::uint64_t count = 1;
    for (int& size : shape) {
      const auto least = size < 0 ? 0u : std::uint32_t(size);
      size = int(cursor_.number("a size of " + name + of_, least, size < 0 ? kLargestSize : least));
      count = std::min(count * std::uint64_t(size), std::uint64_t{1} << 32);  // more than a file holds
    }
    return std::size_t(count);
  }
  template <class T>
  T* copied(const std::string& name, std::size_t count) {
    const unsigned char* numbers = cursor_.take(sizeof(T) * std::uint64_t(count), name + of_);
    T* copy = arena_.take<T>(count);
    if (count > 0) std::memcpy(copy, numbers, sizeof(T) * count);
    return copy;
  }

  Cursor& cursor_;
  std::string of_;  // what the fields are of, as messages say it
  Arena& arena_;
};

BoundOrder read_order(Cursor& cursor, const std::string& of, std::uint32_t garments, Arena& arena) {
  BoundOrder order;
  for (int* layer : {&order.steady, &order.yielding}) *layer = int(cursor.number("a layer" + of, 0, garments - 1));
  const auto edge = cursor.number<float>("edge" + of);
  if (!(edge > 0 && edge < 1)) {
    throw FileError("the edge" + of + " is " + std::to_string(edge) + " m; must be above 0, below 1");
  }
  FileFields fields(cursor, of, arena);
  order.data = read_layer_order(fields);
  order.data.edge = edge;
  return order;
}

}  // namespace

BoundFile::BoundFile(const unsigned char* data, std::size_t size) {
  constexpr char kAnew[] = "; `physkin bind` it anew";
  if (size > kLargestFile) {
    throw FileError("the file has more than " + std::to_string(kLargestFile) + " bytes, which is all that are read");
  }
  if (size < kHeader || std::memcmp(data, kMagic, sizeof kMagic - 1) != 0) {
    throw FileError("the file of " + std::to_string(size) +
                    " bytes is no bound garment, or was bound by another version" + kAnew);
  }
  std::uint32_t version, sum;
  std::memcpy(&version, data + 8, 4);
  std::memcpy(&sum, data + 12, 4);
  if (version != kBoundFileVersion) {
    throw FileError("the file has version " + std::to_string(version) + "; this library reads " +
                    std::to_string(kBoundFileVersion) + kAnew);
  }
  if (sum != crc32(data + kHeader, size - kHeader)) {
    throw FileError(std::string("the file is cut off or damaged: its checksum does not match") + kAnew);
  }
  Cursor cursor(data + kHeader, size - kHeader);
  for (auto left = cursor.number("the number of texts", 0, kLargestSize); left > 0; --left) {
    for (const char* what : {"the name of a text", "a text"}) cursor.text(what);
  }
  joint_names = cursor.texts("names of joints");
  const std::uint32_t count = cursor.number("the number of garments", 1, kMostGarments);
  for (std::uint32_t k = 0; k < count; ++k) {
    const std::string of = " of garment " + std::to_string(k);
    garment_names.push_back(cursor.text("the name" + of));
    fabric_names.push_back(cursor.texts("fabrics" + of));
    FileFields fields(cursor, of, arena);
    garments.push_back(read_bound_garment(fields));
    if (fabric_names.back().size() != 1 + std::size_t(garments.back().fabrics)) {
      throw FileError("the file names " + std::to_string(fabric_names.back().size()) + " fabrics" + of + "; expected " +
                      std::to_string(1 + garments.back().fabrics));
    }
  }
  for (auto k = 0u, orders_held = cursor.number("the number of orders", 0, kMostOrders); k < orders_held; ++k) {
    orders.push_back(read_order(cursor, " of order " + std::to_string(k), count, arena));
  }
  if (!cursor.at_end()) throw FileError("the file goes on behind its last array; it is damaged");
  if (joint_names.size() != std::size_t(garments.front().dofs)) {
    throw FileError("the file names " + std::to_string(joint_names.size()) + " joints; expected " +
                    std::to_string(garments.front().dofs));
  }
}

}  // namespace physkin

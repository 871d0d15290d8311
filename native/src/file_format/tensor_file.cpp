#include "file_format/tensor_file.hpp"

#include <cstring>

namespace physkin {
namespace {

// No dimension of a garment comes near, and products with the handful of numbers an element has fit an int.
constexpr std::uint64_t kLargestSize = std::uint64_t{1} << 24;

// The part of JSON that a header consists of: objects, strings and lists, whole numbers from 0.
class JsonReader {
 public:
  JsonReader(const char* begin, std::size_t size) : at_(begin), end_(begin + size) {}

  [[noreturn]] void fail(const std::string& what) const {
    throw FileError("header of the file is malformed: " + what + ", " + std::to_string(end_ - at_) +
                    " bytes before its end");
  }

  void skip_blanks() {
    while (at_ < end_ && (*at_ == ' ' || *at_ == '\n' || *at_ == '\t' || *at_ == '\r')) ++at_;
  }
  bool take(char wanted) {
    skip_blanks();
    if (at_ == end_ || *at_ != wanted) return false;
    ++at_;
    return true;
  }
  void expect(char wanted) {
    if (!take(wanted)) fail(std::string("expected '") + wanted + "'");
  }
  void expect_end() {
    skip_blanks();
    if (at_ != end_) fail("more text follows");
  }

  std::uint64_t number() {
    skip_blanks();
    if (at_ == end_ || *at_ < '0' || *at_ > '9') fail("expected a whole number");
    std::uint64_t value = 0;
    for (; at_ < end_ && *at_ >= '0' && *at_ <= '9'; ++at_) {
      if (value > (~std::uint64_t{0} - 9) / 10) fail("a number is too large");
      value = 10 * value + std::uint64_t(*at_ - '0');
    }
    return value;
  }

  std::string string() {
    expect('"');
    std::string text;
    while (at_ < end_ && *at_ != '"') {
      if (static_cast<unsigned char>(*at_) < 0x20) fail("a control character in a string");
      if (*at_ != '\\') {
        text += *at_++;
        continue;
      }
      if (++at_ == end_) break;
      append_escaped(text, *at_++);
    }
    if (at_ == end_) fail("a string has no end");
    ++at_;
    return text;
  }

  // item() for each element between the brackets.
  template <class Item>
  void list(char open, char close, Item item) {
    expect(open);
    if (take(close)) return;
    do item();
    while (take(','));
    expect(close);
  }

 private:
  void append_escaped(std::string& text, char kind) {
    static const char kinds[] = "\"\\/bfnrt", values[] = "\"\\/\b\f\n\r\t";
    if (const char* found = kind == '\0' ? nullptr : std::strchr(kinds, kind)) {
      text += values[found - kinds];
      return;
    }
    if (kind != 'u') fail("an unknown escape in a string");
    std::uint32_t code = hex4();
    if (code >= 0xd800 && code < 0xdc00) {
      if (end_ - at_ < 2 || at_[0] != '\\' || at_[1] != 'u') fail("half a surrogate pair in a string");
      at_ += 2;
      const std::uint32_t low = hex4();
      if (low < 0xdc00 || low > 0xdfff) fail("half a surrogate pair in a string");
      code = 0x10000 + ((code - 0xd800) << 10) + (low - 0xdc00);
    } else if (code >= 0xdc00 && code < 0xe000) {
      fail("half a surrogate pair in a string");
    }
    append_utf8(text, code);
  }

  std::uint32_t hex4() {
    if (end_ - at_ < 4) fail("a string has no end");
    std::uint32_t code = 0;
    for (int k = 0; k < 4; ++k, ++at_) {
      static const char digits[] = "0123456789abcdefABCDEF";
      const char* found = *at_ == '\0' ? nullptr : std::strchr(digits, *at_);
      if (found == nullptr) fail("an unknown escape in a string");
      const auto digit = std::uint32_t(found - digits);
      code = 16 * code + (digit < 16 ? digit : digit - 6);
    }
    return code;
  }

  static void append_utf8(std::string& text, std::uint32_t code) {
    if (code < 0x80) {
      text += char(code);
    } else if (code < 0x800) {
      text += {char(0xc0 | code >> 6), char(0x80 | (code & 0x3f))};
    } else if (code < 0x10000) {
      text += {char(0xe0 | code >> 12), char(0x80 | (code >> 6 & 0x3f)), char(0x80 | (code & 0x3f))};
    } else {
      text += {char(0xf0 | code >> 18), char(0x80 | (code >> 12 & 0x3f)), char(0x80 | (code >> 6 & 0x3f)),
               char(0x80 | (code & 0x3f))};
    }
  }

  const char* at_;
  const char* end_;
};

template <class Size>
std::string text_of(const std::vector<Size>& shape) {
  std::string text;
  for (Size size : shape) text += (text.empty() ? "" : ", ") + (size == Size(-1) ? "any" : std::to_string(size));
  return "(" + text + ")";
}

}  // namespace

std::vector<std::string> parse_string_list(const std::string& text) {
  JsonReader reader(text.data(), text.size());
  std::vector<std::string> strings;
  reader.list('[', ']', [&] { strings.push_back(reader.string()); });
  reader.expect_end();
  return strings;
}

TensorFile::TensorFile(const unsigned char* data, std::size_t size) {
  if (size < 8)
    throw FileError("the file has " + std::to_string(size) + " bytes; it is cut off or no safetensors file");
  std::uint64_t header = 0;
  for (int k = 0; k < 8; ++k) header |= std::uint64_t(data[k]) << (8 * k);
  if (header > size - 8) {
    throw FileError("the header claims " + std::to_string(header) + " bytes, the file has " + std::to_string(size) +
                    "; it is cut off or no safetensors file");
  }
  numbers_ = data + 8 + header;
  const std::uint64_t room = size - 8 - header;

  JsonReader reader(reinterpret_cast<const char*>(data) + 8, std::size_t(header));
  reader.list('{', '}', [&] {
    const std::string name = reader.string();
    reader.expect(':');
    if (name == "__metadata__") {
      reader.list('{', '}', [&] {
        const std::string key = reader.string();
        reader.expect(':');
        if (!metadata_.emplace(key, reader.string()).second) reader.fail("metadata " + key + " twice");
      });
      return;
    }
    Tensor tensor;
    std::vector<std::uint64_t> offsets;
    reader.list('{', '}', [&] {
      const std::string key = reader.string();
      reader.expect(':');
      if (key == "dtype") {
        tensor.type = reader.string();
      } else if (key == "shape" || key == "data_offsets") {
        std::vector<std::uint64_t>& numbers = key == "shape" ? tensor.shape : offsets;
        numbers.clear();
        reader.list('[', ']', [&] { numbers.push_back(reader.number()); });
      } else {
        reader.fail("unknown entry " + key);
      }
    });
    if (offsets.size() != 2 || offsets[0] > offsets[1] || offsets[1] > room) {
      throw FileError(name + " lies outside the file; it is cut off or damaged");
    }
    tensor.begin = offsets[0];
    tensor.end = offsets[1];
    if (!tensors_.emplace(name, tensor).second) reader.fail(name + " twice");
  });
  reader.expect_end();
}

const std::string& TensorFile::metadata(const std::string& name) const {
  const auto found = metadata_.find(name);
  if (found == metadata_.end()) throw FileError("the file has no metadata " + name);
  return found->second;
}

const unsigned char* TensorFile::numbers(const std::string& name, const char* type, std::vector<int>& shape) {
  const auto found = tensors_.find(name);
  if (found == tensors_.end()) throw FileError("the file lacks " + name);
  Tensor& tensor = found->second;
  bool good = tensor.type == type && tensor.shape.size() == shape.size();
  const std::vector<int> wanted = shape;
  std::uint64_t elements = 1;
  for (std::size_t axis = 0; good && axis < shape.size(); ++axis) {
    const std::uint64_t size = tensor.shape[axis];
    good = size <= kLargestSize && (wanted[axis] < 0 || std::uint64_t(wanted[axis]) == size);
    if (!good) break;
    shape[axis] = int(size);
    elements *= size;
    // Before another factor of at most kLargestSize could overflow.
    if (elements > std::uint64_t{1} << 36) good = false;
  }
  if (!good) {
    throw FileError(name + " is of type " + tensor.type + " and shape " + text_of(tensor.shape) + "; expected " + type +
                    " " + text_of(wanted));
  }
  if (tensor.end - tensor.begin != 4 * elements) {
    throw FileError(name + " has " + std::to_string(tensor.end - tensor.begin) + " bytes; expected " +
                    std::to_string(4 * elements));
  }
  tensor.read = true;
  return numbers_ + tensor.begin;
}

void TensorFile::refuse_unread() const {
  for (const auto& [name, tensor] : tensors_) {
    if (!tensor.read) throw FileError("the file holds an array that is not known: " + name);
  }
}

}  // namespace physkin

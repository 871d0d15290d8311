#include "file_format/tensor_file.hpp"

#include <algorithm>
#include <cstring>

#include "file_format/sha256.hpp"

namespace physkin {
namespace {

// No dimension of a garment comes near, and products with the handful of numbers an element has fit an int.
constexpr std::uint64_t kLargestSize = std::uint64_t{1} << 24;
constexpr std::uint64_t kLargestHeader = std::uint64_t{1} << 20;
constexpr std::size_t kLongestShown = 60;

// What the file may hold: how safetensors and NumPy call it, and the bytes of a number.
struct NumberType {
  const char *name, *in_digest;
  std::uint64_t bytes;
};
constexpr NumberType kTypes[] = {{"F32", "<f4", 4}, {"I32", "<i4", 4}, {"I8", "|i1", 1}};

// Throws FileError naming the tensor.
const NumberType& type_of(const std::string& tensor, const std::string& type) {
  for (const NumberType& each : kTypes) {
    if (type == each.name) return each;
  }
  throw FileError(shown(tensor) + " is of type " + shown(type) + "; allowed: F32, I32, I8");
}

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
  return "(" + text + (shape.size() == 1 ? ",)" : ")");
}

// Of the numbers of a tensor of so many `bytes` each; the largest there is where they are more than that.
std::uint64_t byte_count(const std::vector<std::uint64_t>& shape, std::uint64_t bytes) {
  for (const std::uint64_t size : shape) {
    if (size != 0 && bytes > ~std::uint64_t{0} / size) return ~std::uint64_t{0};
    bytes *= size;
  }
  return bytes;
}

}  // namespace

std::string shown(const std::string& text) {
  std::string safe = text.substr(0, kLongestShown);
  for (char& letter : safe) {
    if (letter < 0x20 || letter > 0x7e) letter = '?';
  }
  return text.size() > kLongestShown ? safe + "..." : safe;
}

std::vector<std::string> parse_string_list(const std::string& text) {
  JsonReader reader(text.data(), text.size());
  std::vector<std::string> strings;
  reader.list('[', ']', [&] { strings.push_back(reader.string()); });
  reader.expect_end();
  return strings;
}

TensorFile::TensorFile(const unsigned char* data, std::size_t size) {
  if (size > kLargestFile) {
    throw FileError("the file has more than " + std::to_string(kLargestFile) + " bytes, which is all that are read");
  }
  if (size < 8)
    throw FileError("the file has " + std::to_string(size) + " bytes; it is cut off or no safetensors file");
  std::uint64_t header = 0;
  for (int k = 0; k < 8; ++k) header |= std::uint64_t(data[k]) << (8 * k);
  if (header > size - 8) {
    throw FileError("the header claims " + std::to_string(header) + " bytes, the file has " + std::to_string(size) +
                    "; it is cut off or no safetensors file");
  }
  if (header > kLargestHeader) {
    throw FileError("the header has " + std::to_string(header) + " bytes; at most " + std::to_string(kLargestHeader) +
                    " are read");
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
        if (!metadata_.emplace(key, reader.string()).second) reader.fail("metadata " + shown(key) + " twice");
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
        reader.fail("unknown entry " + shown(key));
      }
    });
    if (offsets.size() != 2 || offsets[0] > offsets[1] || offsets[1] > room) {
      throw FileError(shown(name) + " lies outside the file; it is cut off or damaged");
    }
    tensor.begin = offsets[0];
    tensor.end = offsets[1];
    check(name, tensor);
    if (!tensors_.emplace(name, tensor).second) reader.fail(shown(name) + " twice");
  });
  reader.expect_end();
  check_order(room);
}

void TensorFile::check(const std::string& name, const Tensor& tensor) {
  const std::uint64_t bytes = byte_count(tensor.shape, type_of(name, tensor.type).bytes);
  if (tensor.end - tensor.begin != bytes) {
    throw FileError(shown(name) + " has " + std::to_string(tensor.end - tensor.begin) + " bytes; expected " +
                    std::to_string(bytes));
  }
}

void TensorFile::check_order(std::uint64_t room) const {
  std::vector<std::pair<std::uint64_t, std::uint64_t>> spans;
  for (const auto& [name, tensor] : tensors_) spans.emplace_back(tensor.begin, tensor.end);
  std::sort(spans.begin(), spans.end());
  std::uint64_t end = 0;
  for (const auto& [begin, its_end] : spans) {
    if (begin != end) throw FileError("the arrays of the file overlap, or leave room between them; it is damaged");
    end = its_end;
  }
  if (end != room) throw FileError("the file goes on behind its last array; it is damaged");
}

std::string TensorFile::digest() const {
  Sha256 sha256;
  const auto add = [&](const std::string& text) { sha256.update(text.c_str(), text.size() + 1); };
  for (const auto& [key, value] : metadata_) {
    if (key == kDigest) continue;
    add(key);
    add(value);
  }
  for (const auto& [name, tensor] : tensors_) {
    add(name);
    add(type_of(name, tensor.type).in_digest);
    add(text_of(tensor.shape));
    sha256.update(numbers_ + tensor.begin, std::size_t(tensor.end - tensor.begin));
  }
  return sha256.digits();
}

const std::string& TensorFile::metadata(const std::string& name) const {
  const auto found = metadata_.find(name);
  if (found == metadata_.end()) throw FileError("the file has no metadata " + name);
  return found->second;
}

bool TensorFile::holds_steps(const std::string& name) const {
  const auto found = tensors_.find(name);
  return found != tensors_.end() && found->second.type == "I8";
}

const unsigned char* TensorFile::numbers(const std::string& name, const char* type, std::vector<int>& shape) {
  const auto found = tensors_.find(name);
  if (found == tensors_.end()) throw FileError("the file lacks " + name);
  Tensor& tensor = found->second;
  bool good = tensor.type == type && tensor.shape.size() == shape.size();
  const std::vector<int> wanted = shape;
  for (std::size_t axis = 0; good && axis < shape.size(); ++axis) {
    const std::uint64_t size = tensor.shape[axis];
    good = size <= kLargestSize && (wanted[axis] < 0 || std::uint64_t(wanted[axis]) == size);
    shape[axis] = int(size);
  }
  if (!good) {
    throw FileError(name + " is of type " + tensor.type + " and shape " + shown(text_of(tensor.shape)) + "; expected " +
                    type + " " + text_of(wanted));
  }
  tensor.read = true;
  return numbers_ + tensor.begin;
}

void TensorFile::refuse_unread() const {
  for (const auto& [name, tensor] : tensors_) {
    if (!tensor.read) throw FileError("the file holds an array that is not known: " + shown(name));
  }
}

}  // namespace physkin

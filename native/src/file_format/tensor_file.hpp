// Reading of safetensors files: a JSON header of names, types, shapes and offsets, then the numbers.
#pragma once

#include <cstdint>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

namespace physkin {

// A file that is damaged, or not what it should be.
class FileError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// A JSON list of strings. Throws FileError.
std::vector<std::string> parse_string_list(const std::string& text);

class TensorFile {
 public:
  // Checks the whole header; throws FileError. `data` is viewed, not copied.
  TensorFile(const unsigned char* data, std::size_t size);

  // Value of the metadata entry; throws FileError if there is none.
  const std::string& metadata(const std::string& name) const;
  bool contains(const std::string& name) const { return tensors_.count(name) != 0; }

  // The numbers of a tensor, four bytes each, at any address. A negative size in `shape` allows any and is filled in.
  // Throws FileError if there is no such tensor, or it has another type or shape.
  const unsigned char* numbers(const std::string& name, const char* type, std::vector<int>& shape);

  // Throws FileError naming a tensor that was never asked for, if there is one.
  void refuse_unread() const;

 private:
  struct Tensor {
    std::string type;
    std::vector<std::uint64_t> shape;
    std::uint64_t begin = 0, end = 0;
    bool read = false;
  };

  const unsigned char* numbers_ = nullptr;
  std::map<std::string, std::string> metadata_;
  std::map<std::string, Tensor> tensors_;
};

}  // namespace physkin

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

// [bytes] No garment comes near.
constexpr std::size_t kLargestFile = std::size_t{1} << 29;

// Metadata entry: what `TensorFile::digest` gave when the file was written.
constexpr char kDigest[] = "sha256";

// As a message may hold it: what is printable of a text out of a file, and not more than a line of it.
std::string shown(const std::string& text);

class TensorFile {
 public:
  // Checks the whole header: arrays of float32, int32 and int8 that fill the file, one behind the other. Throws FileError.
  // `data` is viewed, not copied.
  TensorFile(const unsigned char* data, std::size_t size);

  // Value of the metadata entry; throws FileError if there is none.
  const std::string& metadata(const std::string& name) const;
  bool contains(const std::string& name) const { return tensors_.count(name) != 0; }

  // SHA-256 of all metadata but `kDigest` and all tensors, in the order of their names: each text and a zero, then the
  // numbers. physkin_core/tensor_file.py computes the same.
  std::string digest() const;

  // Whether a tensor is one of 8-bit integers.
  bool holds_steps(const std::string& name) const;

  // The numbers of a tensor of type "F32", "I32" or "I8", at any address. A negative size in `shape` allows any and is filled in.
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

  static void check(const std::string& name, const Tensor& tensor);
  void check_order(std::uint64_t room) const;

  const unsigned char* numbers_ = nullptr;
  std::map<std::string, std::string> metadata_;
  std::map<std::string, Tensor> tensors_;
};

}  // namespace physkin

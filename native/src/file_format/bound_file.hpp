// The bound garment file: a garment model, or several worn over each other, bound to one body. Written by
// physkin_core/runtime/bound_file.py, which says how it is laid out.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"
#include "outfit/layer_order.hpp"

namespace physkin {

// A file that is damaged, or not what it should be.
class FileError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// [bytes] No garment comes near.
constexpr std::size_t kLargestFile = std::size_t{1} << 29;

// Of which two garments the order is kept, as of Evaluator::keep_order.
struct BoundOrder {
  int steady = 0, yielding = 0;
  LayerOrderData data;
};

// Its arrays live in its arena.
struct BoundFile {
  // Throws FileError where the data are no such file; what the arrays hold is for the evaluator to check.
  BoundFile(const unsigned char* data, std::size_t size);
  BoundFile(const BoundFile&) = delete;
  BoundFile& operator=(const BoundFile&) = delete;

  Arena arena;
  std::vector<std::string> joint_names;                // (dofs,)
  std::vector<BoundGarment> garments;                  // from the skin outwards
  std::vector<std::string> garment_names;              // of each
  std::vector<std::vector<std::string>> fabric_names;  // of each: what it is bound as, and the others
  std::vector<BoundOrder> orders;
};

}  // namespace physkin

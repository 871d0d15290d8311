// The bound garment file: a garment model bound to one body. Written by physkin_core/runtime/bound_file.py.
#pragma once

#include <string>
#include <vector>

#include "garment/bound_garment.hpp"
#include "kernels/arena.hpp"

namespace physkin {

// Its arrays live in its arena.
struct BoundFile {
  // Throws FileError where the data are no such file; what the arrays hold is for the evaluator to check.
  BoundFile(const unsigned char* data, std::size_t size);
  BoundFile(const BoundFile&) = delete;
  BoundFile& operator=(const BoundFile&) = delete;

  Arena arena;
  BoundGarment garment;
  std::vector<std::string> joint_names;  // (dofs,)
};

}  // namespace physkin

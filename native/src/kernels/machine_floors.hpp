// Probes of what a core of this machine can do at best, for `physkin bench` to time beside the evaluator.
#pragma once

#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

class MachineProbe {
 public:
  // bytes: how much `read` reads; rounded up to 1024.
  MachineProbe(const Kernels& kernels, std::int64_t bytes);
  MachineProbe(const MachineProbe&) = delete;  // its members point into its own arena
  MachineProbe& operator=(const MachineProbe&) = delete;

  // Reads the memory once, from front to back, as a network may. Returns the bytes read.
  std::int64_t read(bool fetch_ahead) noexcept;

  // Multiplies and adds 32-bit floats in registers. Returns how many times.
  std::int64_t multiply_add(int rounds) noexcept;

 private:
  const Kernels& kernels_;
  Arena arena_;
  std::int64_t bytes_;
  const unsigned char* memory_;
  float* result_;
};

}  // namespace physkin

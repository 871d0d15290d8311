// Probes of what a core of this machine can do at best, for `physkin bench` to time beside the evaluator.
#pragma once

#include <algorithm>
#include <stdexcept>

#include "kernels/arena.hpp"
#include "kernels/kernels.hpp"

namespace physkin {

class MachineProbe {
 public:
  // bytes: how much `read` reads, at most 4 GiB; rounded up to what floor_kernel.hpp reads at once.
  MachineProbe(const Kernels& kernels, std::int64_t bytes) : kernels_(kernels), bytes_((bytes + 1023) / 1024 * 1024) {
    if (bytes < 1 || bytes > (std::int64_t{1} << 32)) throw std::invalid_argument("a probe reads 1 byte to 4 GiB");
    memory_ = arena_.take<unsigned char>(std::size_t(bytes_));
    result_ = arena_.take<float>(kAlignment / sizeof(float));
  }
  MachineProbe(const MachineProbe&) = delete;  // its members point into its own arena
  MachineProbe& operator=(const MachineProbe&) = delete;

  // Reads the memory once, from front to back, as a network may. Returns the bytes read.
  std::int64_t read(bool fetch_ahead) noexcept {
    kernels_.read_memory(memory_, bytes_, fetch_ahead, result_);
    return bytes_;
  }

  // Multiplies and adds 32-bit floats in registers. Returns how many times.
  std::int64_t multiply_add(int rounds) noexcept {
    std::fill_n(result_, kAlignment / sizeof(float), 0.999f);
    return kernels_.multiply_add(rounds, result_);
  }

 private:
  const Kernels& kernels_;
  Arena arena_;
  std::int64_t bytes_;
  const unsigned char* memory_ = nullptr;
  float* result_ = nullptr;
};

}  // namespace physkin

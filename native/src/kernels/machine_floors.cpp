#include "kernels/machine_floors.hpp"

#include <algorithm>
#include <stdexcept>

namespace physkin {
namespace {

constexpr std::int64_t kStep = 1024;  // what floor_kernel.hpp reads at once, at least

std::int64_t checked(std::int64_t bytes) {
  if (bytes < 1 || bytes > (std::int64_t{1} << 32)) throw std::invalid_argument("a probe reads 1 byte to 4 GiB");
  return (bytes + kStep - 1) / kStep * kStep;
}

}  // namespace

MachineProbe::MachineProbe(const Kernels& kernels, std::int64_t bytes)
    : kernels_(kernels),
      bytes_(checked(bytes)),
      memory_(arena_.take<unsigned char>(std::size_t(bytes_))),
      result_(arena_.take<float>(kAlignment / sizeof(float))) {}

std::int64_t MachineProbe::read(bool fetch_ahead) noexcept {
  kernels_.read_memory(memory_, bytes_, fetch_ahead, result_);
  return bytes_;
}

std::int64_t MachineProbe::multiply_add(int rounds) noexcept {
  std::fill_n(result_, kAlignment / sizeof(float), 0.999f);
  return kernels_.multiply_add(rounds, result_);
}

}  // namespace physkin

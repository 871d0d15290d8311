#include "machine_floors.hpp"

#include <algorithm>
#include <chrono>

#include "arena.hpp"

namespace physkin {
namespace {

// Amount of work done a second by `work`, which returns the amount: the best of `runs`, after one to warm up.
template <class Work>
double best_rate(int runs, Work work) {
  double best = 0.0;
  for (int run = 0; run <= runs; ++run) {
    const auto start = std::chrono::steady_clock::now();
    const double amount = work();
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    if (run > 0) best = std::max(best, amount / seconds);
  }
  return best;
}

double read_rate(const Kernels& kernels, const unsigned char* data, std::int64_t bytes, int passes, int runs) {
  alignas(kAlignment) float result[16];
  return best_rate(runs, [&] {
    for (int pass = 0; pass < passes; ++pass) kernels.read_memory(data, bytes, result);
    return double(bytes) * passes;
  });
}

}  // namespace

MachineFloors measure_machine_floors(const Kernels& kernels) {
  constexpr std::int64_t kKiB = 1024, kMiB = 1024 * kKiB;
  MachineFloors floors;
  alignas(kAlignment) float factors[16];
  floors.multiply_adds_per_second = best_rate(20, [&] {
    std::fill_n(factors, 16, 0.999f);
    return double(kernels.multiply_add(100000, factors));
  });
  Arena arena;
  const unsigned char* data = arena.take<unsigned char>(256 * kMiB);
  floors.l2_bytes_per_second = read_rate(kernels, data, 512 * kKiB, 20, 20);
  floors.l3_bytes_per_second = read_rate(kernels, data, 4 * kMiB, 4, 20);
  floors.memory_bytes_per_second = read_rate(kernels, data, 256 * kMiB, 1, 4);
  return floors;
}

}  // namespace physkin

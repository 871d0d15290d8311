// Loops that do nothing but multiply and add, or nothing but read: what bounds the other kernels from below. Included
// by kernel_unit.cpp only (see simd.hpp).
#pragma once

#include "kernels/dense_kernel.hpp"
#include "kernels/kernels.hpp"
#include "kernels/simd.hpp"

namespace physkin::PHYSKIN_ISA {

// Independent chains in registers; returns the multiply-adds done (of single floats).
inline std::int64_t multiply_add(int rounds, float* result) {
  constexpr int kChains = 12;
  Floats sum[kChains];
  const Floats factor = load(result), term = factor * 0.5f;
  for (int k = 0; k < kChains; ++k) sum[k] = factor * float(k);  // equal chains would be computed once
  for (int round = 0; round < rounds; ++round) {
    for (int k = 0; k < kChains; ++k) sum[k] = sum[k] * factor + term;
  }
  Floats total = {};
  for (int k = 0; k < kChains; ++k) total += sum[k];
  store(result, total);
  return std::int64_t(rounds) * kChains * kLanes;
}

// Reads `bytes`, a multiple of 1024, from front to back. `result` (16) depends on every byte.
template <bool kAhead>
inline void read_memory_by(const unsigned char* data, std::int64_t bytes, float* result) {
  constexpr int kChains = 8;
  Ints sum[kChains] = {};
  constexpr int kStep = kChains * kLanes * 4;
  for (const unsigned char* end = data + bytes; data < end; data += kStep) {
    if (kAhead) prefetch(data + kBytesAhead, kStep);  // as the networks do on most processors
    for (int k = 0; k < kChains; ++k) sum[k] ^= load_ints(data + k * kLanes * 4);
  }
  Ints total = {};
  for (int k = 0; k < kChains; ++k) total ^= sum[k];
  store(result, (Floats)total);
}

inline void read_memory(const unsigned char* data, std::int64_t bytes, bool fetch_ahead, float* result) {
  return (fetch_ahead ? read_memory_by<true> : read_memory_by<false>)(data, bytes, result);
}

}  // namespace physkin::PHYSKIN_ISA

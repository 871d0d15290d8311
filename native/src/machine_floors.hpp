// What this machine's core can do at best: measured, for `physkin bench`.
#pragma once

#include "kernels.hpp"

namespace physkin {

// Rates of one core with one instruction set, the best of several short runs.
struct MachineFloors {
  double multiply_adds_per_second = 0.0;  // of 32-bit floats, in registers
  double l2_bytes_per_second = 0.0;       // reading 512 KiB again and again
  double l3_bytes_per_second = 0.0;       // 4 MiB: what network weights take
  double memory_bytes_per_second = 0.0;   // 256 MiB, once
};

// Takes about a third of a second and 256 MiB for as long.
MachineFloors measure_machine_floors(const Kernels& kernels);

}  // namespace physkin

// Choice of the instruction set and of the precision at run time.
#pragma once

#include <string>
#include <vector>

#include "kernels/kernels.hpp"

namespace physkin {

// Names of the instruction sets this CPU runs, narrowest first: "baseline", "v3" (AVX2, FMA), "v3_vnni" (AVX-VNNI),
// "v4" (AVX-512), "v4_vnni" (AVX-512 VNNI); on ARM "baseline" (NEON), "dotprod", "i8mm".
std::vector<std::string> supported_instruction_sets();

// Kernels of the named instruction set; an empty name means the environment variable PHYSKIN_NATIVE_ISA, and without
// that the widest one supported. Throws std::invalid_argument for a name that is unknown or not supported here.
const Kernels& select_kernels(const std::string& name = "");

// The named precision; an empty name means the environment variable PHYSKIN_NATIVE_PRECISION, and without that int8.
// Throws std::invalid_argument for an unknown name.
Precision select_precision(const std::string& name = "");
const char* precision_name(Precision precision);

// Whether instructions that fetch network weights ahead of time make this processor read them faster. Emerald Rapids
// takes an eighth (AVX-512 VNNI) to a quarter (AVX2) less time with them where the weights lie in memory, and Zen 5 stops
// at the end of every page without them. Zen 4 reads from L3 a quarter faster without; from memory it was not measured.
bool fetches_ahead();

}  // namespace physkin

// Precision in which network weights are stored.
#pragma once

#include <string>

namespace physkin {

// fp32: the reference. bf16: 16-bit floats, widened in registers, activations in fp32. int8: 8-bit integers with one
// scale an output, activations rounded to 16-bit integers layer by layer; the layer that reads bone transforms in bf16.
enum class Precision { fp32, bf16, int8 };
constexpr int kPrecisionCount = 3;

const char* precision_name(Precision precision);

// The named precision; an empty name means the environment variable PHYSKIN_NATIVE_PRECISION, and without that bf16.
// Throws std::invalid_argument for an unknown name.
Precision select_precision(const std::string& name = "");

}  // namespace physkin

#include "kernels/precision.hpp"

#include <cstdlib>
#include <stdexcept>

namespace physkin {
namespace {

constexpr const char* kNames[kPrecisionCount] = {"fp32", "bf16", "int8"};

}  // namespace

const char* precision_name(Precision precision) { return kNames[int(precision)]; }

Precision select_precision(const std::string& name) {
  const char* forced = std::getenv("PHYSKIN_NATIVE_PRECISION");
  const std::string wanted = name.empty() && forced != nullptr ? forced : name;
  if (wanted.empty()) return Precision::bf16;
  for (int k = 0; k < kPrecisionCount; ++k) {
    if (wanted == kNames[k]) return Precision(k);
  }
  throw std::invalid_argument("precision '" + wanted + "'" + (name.empty() ? " (from PHYSKIN_NATIVE_PRECISION)" : "") +
                              " is unknown; it may be fp32, bf16 or int8");
}

}  // namespace physkin

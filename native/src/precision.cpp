#include "precision.hpp"

#include <cstdlib>
#include <stdexcept>

namespace physkin {
namespace {

constexpr const char* kNames[kPrecisionCount] = {"fp32", "bf16", "int8"};

std::string environment(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? "" : value;
}

}  // namespace

const char* precision_name(Precision precision) { return kNames[int(precision)]; }

Precision select_precision(const std::string& name) {
  const std::string wanted = name.empty() ? environment("PHYSKIN_NATIVE_PRECISION") : name;
  if (wanted.empty()) return Precision::bf16;
  for (int k = 0; k < kPrecisionCount; ++k) {
    if (wanted == kNames[k]) return Precision(k);
  }
  throw std::invalid_argument("precision '" + wanted + "'" + (name.empty() ? " (from PHYSKIN_NATIVE_PRECISION)" : "") +
                              " is unknown; it may be fp32, bf16 or int8");
}

ZeroSkipping select_zero_skipping() {
  const std::string wanted = environment("PHYSKIN_NATIVE_ZEROS");
  if (wanted.empty()) return ZeroSkipping::measured;
  if (wanted == "skip") return ZeroSkipping::always;
  if (wanted == "read") return ZeroSkipping::never;
  throw std::invalid_argument("PHYSKIN_NATIVE_ZEROS is '" + wanted + "'; it may be skip or read, or unset");
}

}  // namespace physkin

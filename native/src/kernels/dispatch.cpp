#include "kernels/dispatch.hpp"

#include <cstdlib>
#include <stdexcept>

#if defined(PHYSKIN_X86_LEVELS)
#include <cpuid.h>
#elif defined(PHYSKIN_ARM_LEVELS) && defined(__linux__)
#include <sys/auxv.h>
#endif

namespace physkin {

namespace baseline {
extern const Kernels kernels;
}
#if defined(PHYSKIN_X86_LEVELS)
namespace v3 {
extern const Kernels kernels;
}
namespace v3_vnni {
extern const Kernels kernels;
}
namespace v4 {
extern const Kernels kernels;
}
namespace v4_vnni {
extern const Kernels kernels;
}
#elif defined(PHYSKIN_ARM_LEVELS)
namespace dotprod {
extern const Kernels kernels;
}
namespace i8mm {
extern const Kernels kernels;
}
#endif

namespace {

struct Level {
  const Kernels* kernels;
  bool supported;
};

#if defined(PHYSKIN_X86_LEVELS)
// AVX-VNNI, by CPUID leaf 7.1: older compilers have no name for it.
bool has_avx_vnni() {
  unsigned a = 0, b = 0, c = 0, d = 0;
  return __get_cpuid_count(7, 0, &a, &b, &c, &d) != 0 && a >= 1 && __get_cpuid_count(7, 1, &a, &b, &c, &d) != 0 &&
         (a >> 4 & 1) != 0;
}
#endif

std::vector<Level> levels() {
  std::vector<Level> all{{&baseline::kernels, true}};
#if defined(PHYSKIN_X86_LEVELS)
  __builtin_cpu_init();
  const bool v3 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  const bool v4 = v3 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
                  __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw");
  all.push_back({&v3::kernels, v3});
  all.push_back({&v3_vnni::kernels, v3 && has_avx_vnni()});
  all.push_back({&v4::kernels, v4});
  all.push_back({&v4_vnni::kernels, v4 && __builtin_cpu_supports("avx512vnni")});
#elif defined(PHYSKIN_ARM_LEVELS)
#if defined(__linux__)
  const bool dotprod = getauxval(AT_HWCAP) & HWCAP_ASIMDDP, i8mm = getauxval(AT_HWCAP2) & HWCAP2_I8MM;
#elif defined(__APPLE__)
  const bool dotprod = true, i8mm = false;  // the oldest Apple M has the one and not the other
#else
  const bool dotprod = false, i8mm = false;
#endif
  all.push_back({&dotprod::kernels, dotprod});
  all.push_back({&i8mm::kernels, dotprod && i8mm});
#endif
  return all;
}

constexpr const char* kPrecisions[kPrecisionCount] = {"fp32", "bf16", "int8"};

// The name, or without one the environment variable's value, and what to add to an error about it.
struct Wanted {
  Wanted(const std::string& given, const char* variable) : name(given) {
    if (const char* forced = std::getenv(variable); given.empty() && forced != nullptr) {
      name = forced;
      origin = std::string(" (from ") + variable + ")";
    }
  }

  std::string name, origin;
};

}  // namespace

std::vector<std::string> supported_instruction_sets() {
  std::vector<std::string> names;
  for (const Level& level : levels()) {
    if (level.supported) names.push_back(level.kernels->instruction_set);
  }
  return names;
}

const Kernels& select_kernels(const std::string& name) {
  const Wanted wanted(name, "PHYSKIN_NATIVE_ISA");
  const Kernels* widest = nullptr;
  std::string names;
  for (const Level& level : levels()) {
    if (!level.supported) continue;
    widest = level.kernels;
    if (wanted.name == widest->instruction_set) return *widest;
    names += (names.empty() ? "" : ", ") + std::string(widest->instruction_set);
  }
  if (wanted.name.empty()) return *widest;
  throw std::invalid_argument("instruction set '" + wanted.name + "'" + wanted.origin +
                              " is unknown or not supported by this CPU; it supports " + names);
}

const char* precision_name(Precision precision) { return kPrecisions[int(precision)]; }

Precision select_precision(const std::string& name) {
  const Wanted wanted(name, "PHYSKIN_NATIVE_PRECISION");
  if (wanted.name.empty()) return Precision::int8;
  for (int k = 0; k < kPrecisionCount; ++k) {
    if (wanted.name == kPrecisions[k]) return Precision(k);
  }
  throw std::invalid_argument("precision '" + wanted.name + "'" + wanted.origin +
                              " is unknown; it may be fp32, bf16 or int8");
}

bool fetches_ahead() {
#if defined(PHYSKIN_X86_LEVELS)
  __builtin_cpu_init();
  return !__builtin_cpu_is("amdfam19h");  // Zen 4, and 3, which was not measured
#else
  return true;
#endif
}

}  // namespace physkin

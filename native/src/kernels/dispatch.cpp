#include "kernels/dispatch.hpp"

#include <cstdlib>
#include <stdexcept>

namespace physkin {

namespace baseline {
extern const Kernels kernels;
}
#if defined(PHYSKIN_X86_LEVELS)
namespace v3 {
extern const Kernels kernels;
}
namespace v4 {
extern const Kernels kernels;
}
namespace v4_vnni {
extern const Kernels kernels;
}
#endif

namespace {

struct Level {
  const Kernels* kernels;
  bool supported;
};

std::vector<Level> levels() {
  std::vector<Level> all{{&baseline::kernels, true}};
#if defined(PHYSKIN_X86_LEVELS)
  __builtin_cpu_init();
  const bool v3 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  const bool v4 = v3 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
                  __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw");
  all.push_back({&v3::kernels, v3});
  all.push_back({&v4::kernels, v4});
  all.push_back({&v4_vnni::kernels, v4 && __builtin_cpu_supports("avx512vnni")});
#endif
  return all;
}

}  // namespace

std::vector<std::string> supported_instruction_sets() {
  std::vector<std::string> names;
  for (const Level& level : levels()) {
    if (level.supported) names.push_back(level.kernels->instruction_set);
  }
  return names;
}

const Kernels& select_kernels(const std::string& name) {
  const char* forced = std::getenv("PHYSKIN_NATIVE_ISA");
  const std::string wanted = name.empty() && forced != nullptr ? forced : name;
  const Kernels* widest = nullptr;
  std::string names;
  for (const Level& level : levels()) {
    if (!level.supported) continue;
    widest = level.kernels;
    if (wanted == widest->instruction_set) return *widest;
    names += (names.empty() ? "" : ", ") + std::string(widest->instruction_set);
  }
  if (wanted.empty()) return *widest;
  throw std::invalid_argument("instruction set '" + wanted + "'" + (name.empty() ? " (from PHYSKIN_NATIVE_ISA)" : "") +
                              " is unknown or not supported by this CPU; it supports " + names);
}

bool fetches_ahead() {
#if defined(PHYSKIN_X86_LEVELS)
  __builtin_cpu_init();
  return !__builtin_cpu_is("amdfam19h");
#else
  return true;
#endif
}

}  // namespace physkin

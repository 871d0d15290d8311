// Compiled once per instruction set, with PHYSKIN_ISA set to its name and the flags that CMakeLists.txt gives it.
#include "kernels/cloth_kernel.hpp"
#include "kernels/contact_kernel.hpp"
#include "kernels/dense_kernel.hpp"
#include "kernels/oscillator_kernel.hpp"
#include "kernels/ring_kernel.hpp"
#include "kernels/skinning_kernel.hpp"
#include "kernels/token_kernel.hpp"
#include "kernels/trunk_kernel.hpp"

#define PHYSKIN_TEXT_OF(name) #name
#define PHYSKIN_TEXT(name) PHYSKIN_TEXT_OF(name)

namespace physkin::PHYSKIN_ISA {

// None in the module for browsers, which neither separates limbs nor encodes bodies.
template <class Kernel>
constexpr Kernel* unless_in_browser(Kernel* kernel) {
#if defined(__EMSCRIPTEN__)
  kernel = nullptr;
#endif
  return kernel;
}

extern const Kernels kernels;
const Kernels kernels{
    PHYSKIN_TEXT(PHYSKIN_ISA),
    {kPanel, Int8Rows::kLayout},
    {{dense<Fp32Rows, false>, dense<Fp32Rows, true>},
     {dense<Bf16Rows, false>, dense<Bf16Rows, true>},
     {dense<Int8Rows, false>, dense<Int8Rows, true>}},
    skin,
    ring_normals,
    unless_in_browser(trunk_depth),
    meet_skin,
    bound_cloth,
    meet_cloth,
    oscillate,
    unless_in_browser(token_linear),
    unless_in_browser(token_norm),
    unless_in_browser(token_attention),
};

}  // namespace physkin::PHYSKIN_ISA

// Compiled once per instruction set, with PHYSKIN_ISA set to its name and the flags that CMakeLists.txt gives it.
#include "contact_kernel.hpp"
#include "dense_batch_kernel.hpp"
#include "dense_kernel.hpp"
#include "floor_kernel.hpp"
#include "skinning_kernel.hpp"
#include "token_kernel.hpp"

#define PHYSKIN_TEXT_OF(name) #name
#define PHYSKIN_TEXT(name) PHYSKIN_TEXT_OF(name)

namespace physkin::PHYSKIN_ISA {

extern const Kernels kernels;
const Kernels kernels{
    PHYSKIN_TEXT(PHYSKIN_ISA),
    kPanel,
    {dense<Fp32Rows, false>, dense<Bf16Rows, false>, dense<Int8Rows, false>},
    {dense<Fp32Rows, true>, dense<Bf16Rows, true>, dense<Int8Rows, true>},
    {dense_batch<Fp32Rows>, dense_batch<Bf16Rows>, dense_batch<Int8Rows>},
    skin,
    multiply_add,
    read_memory,
    token_linear,
    token_norm,
    token_attention,
    find_near,
    closest_on_patch,
};

}  // namespace physkin::PHYSKIN_ISA

// Compiled once per instruction set, with PHYSKIN_ISA set to its name and the flags that CMakeLists.txt gives it.
#include "dense_batch_kernel.hpp"
#include "dense_kernel.hpp"
#include "floor_kernel.hpp"
#include "skinning_kernel.hpp"
#include "token_kernel.hpp"

#define PHYSKIN_TEXT_OF(name) #name
#define PHYSKIN_TEXT(name) PHYSKIN_TEXT_OF(name)

namespace physkin::PHYSKIN_ISA {

template <class Rows>
constexpr DenseKernels dense_kernels{
    {dense<Rows, Reading::all>, dense<Rows, Reading::all_ahead>},
    dense<Rows, Reading::listed>,
    {dense_batch<Rows, false>, dense_batch<Rows, true>},
};

extern const Kernels kernels;
const Kernels kernels{
    PHYSKIN_TEXT(PHYSKIN_ISA),
    {kPanel, Int8Rows::kLayout},
    {dense_kernels<Fp32Rows>, dense_kernels<Bf16Rows>, dense_kernels<Int8Rows>},
    skin,
    multiply_add,
    read_memory,
    token_linear,
    token_norm,
    token_attention,
};

}  // namespace physkin::PHYSKIN_ISA

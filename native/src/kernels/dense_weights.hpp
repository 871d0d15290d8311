// One dense layer of a network as a garment model holds it.
#pragma once

namespace physkin {

enum class Activation { none, silu, relu };

struct DenseWeights {
  int outputs = 0, inputs = 0;
  const float* matrix = nullptr;  // (outputs, inputs)
  const float* bias = nullptr;    // (outputs,)
};

}  // namespace physkin

// The layers of one instruction set, PHYSKIN_ISA, against plain loops over their inputs: 8-bit network weights, whose
// sums are exact, bit for bit; the others within the rounding of their sums. Prints how many layers agreed, or what did
// not. For processors whose multiply-add is fused.
#include "kernels/dense_kernel.hpp"

#include <cmath>
#include <cstdio>
#include <cstring>
#include <random>

#include "kernels/arena.hpp"

namespace {

using physkin::DenseWeights;
using physkin::Precision;
namespace isa = physkin::PHYSKIN_ISA;

constexpr physkin::DenseKernel kKernels[][2] = {{isa::dense<isa::Fp32Rows, false>, isa::dense<isa::Fp32Rows, true>},
                                                {isa::dense<isa::Bf16Rows, false>, isa::dense<isa::Bf16Rows, true>},
                                                {isa::dense<isa::Int8Rows, false>, isa::dense<isa::Int8Rows, true>}};

std::mt19937 random_bits(41);

float uniform(float low, float high) { return std::uniform_real_distribution<float>(low, high)(random_bits); }

// An output by 8-bit network weights; input_limit: as the packed layer has it.
float int8_output(const DenseWeights& layer, int output, const float* input, float input_limit) {
  const float* weights = layer.matrix + std::size_t(output) * layer.inputs;
  float largest = 0, most = 1e-30f;
  for (int i = 0; i < layer.inputs; ++i) {
    largest = std::max(largest, std::fabs(weights[i]));
    most = std::max(most, std::fabs(input[i]));
  }
  const float scale = std::max(largest / 127.0f, 1e-30f);
  std::int64_t sum = 0;
  for (int i = 0; i < layer.inputs; ++i) {
    const auto weight = std::int64_t(std::round(weights[i] / scale));
    sum += weight * std::int64_t(std::fma(input[i], input_limit / most, 12582912.0f) - 12582912.0f);
  }
  return std::fma(float(sum), scale * (most / input_limit), layer.bias[output]);
}

double exact_output(const DenseWeights& layer, int output, const float* input, double* magnitude) {
  double sum = layer.bias[output];
  *magnitude = std::fabs(sum);
  for (int i = 0; i < layer.inputs; ++i) {
    const double product = double(layer.matrix[std::size_t(output) * layer.inputs + i]) * input[i];
    sum += product;
    *magnitude += std::fabs(product);
  }
  return sum;
}

bool agrees(int inputs, int outputs, Precision precision, bool ahead) {
  physkin::Arena arena;
  float* matrix = arena.take<float>(std::size_t(inputs) * outputs);
  float *bias = arena.take<float>(outputs), *input = arena.take<float>(inputs + 16);
  for (int k = 0; k < inputs * outputs; ++k) matrix[k] = uniform(-1, 1);
  for (int k = 0; k < outputs; ++k) bias[k] = uniform(-1, 1);
  for (int k = 0; k < inputs; ++k) input[k] = uniform(-3, 3);
  input[inputs] = 1e9f;  // beyond the last, which nothing may come of
  const DenseWeights layer{outputs, inputs, matrix, bias};
  const auto packed = physkin::pack_layer(layer, precision, {isa::kPanel, isa::Int8Rows::kLayout}, arena);
  physkin::DenseCall call;
  call.input = input;
  call.quantised = arena.take<std::int16_t>(inputs + physkin::kGroup);
  call.output = arena.take<float>(physkin::padded_to_group(outputs));
  kKernels[int(precision)][ahead](packed, physkin::Activation::none, call);
  for (int k = 0; k < outputs; ++k) {
    double magnitude;
    const double exact = exact_output(layer, k, input, &magnitude);
    const float expected =
        precision == Precision::int8 ? int8_output(layer, k, input, packed.input_limit) : float(exact);
    const double allowed = precision == Precision::int8   ? 0.0
                           : precision == Precision::bf16 ? magnitude / 256
                                                          : magnitude * 1e-6;
    if (!(std::fabs(double(call.output[k]) - expected) <= allowed)) {
      std::printf("%d inputs, %d outputs, precision %d: output %d is %.9g, not %.9g\n", inputs, outputs, int(precision),
                  k, double(call.output[k]), double(expected));
      return false;
    }
  }
  return true;
}

}  // namespace

int main() {
  int agreed = 0;
  for (const int inputs : {1, 2, 3, 4, 5, 7, 8, 9, 12, 13, 31, 64, 120, 257, 512}) {
    for (const int outputs : {1, 31, 32, 33, 96, 130}) {
      for (int precision = 0; precision < physkin::kPrecisionCount; ++precision) {
        for (const bool ahead : {false, true}) {
          if (!agrees(inputs, outputs, Precision(precision), ahead)) return 1;
          ++agreed;
        }
      }
    }
  }
  std::printf("%d\n", agreed);
  return 0;
}

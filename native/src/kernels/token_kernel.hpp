// Layers over a tile of tokens: linear, layer norm, attention. Included by kernel_unit.cpp only (see simd.hpp).
//
// Lanes are tokens, so that every sum over features and every softmax over keys runs down a column and no kernel needs
// a horizontal sum or a transpose. All three are one product, product_rows: rows of broadcast numbers times a tile.
#pragma once

#include "kernels/kernels.hpp"
#include "kernels/simd.hpp"

namespace physkin::PHYSKIN_ISA {

// Sums that stay in registers: 32 of them for AVX-512, 16 before.
constexpr int kTokenRows = 6;
constexpr int kTokenVectors = kLanes == 16 ? 4 : 2;
constexpr int kTokenColumns = kTokenVectors * kLanes;
static_assert(kTokens % kTokenColumns == 0);

// Rows of a matrix read one number at a time: element (row, k) is at data[row * row_stride + k * step].
struct BroadcastRows {
  const float* data;
  std::ptrdiff_t row_stride, step;
};

// target[row] = [start[row]] + sum_k a(row, k) * tile[k] over kTokenColumns tokens; rows are kTokens apart.
template <int kRows, bool kAccumulate>
inline void product_block(BroadcastRows a, int depth, const float* tile, float* target) {
  Floats sum[kRows][kTokenVectors] = {};
  for (int k = 0; k < depth; ++k, tile += kTokens) {
    Floats column[kTokenVectors];
    for (int v = 0; v < kTokenVectors; ++v) column[v] = load(tile + v * kLanes);
    for (int r = 0; r < kRows; ++r) {
      const float factor = a.data[r * a.row_stride + k * a.step];
      for (int v = 0; v < kTokenVectors; ++v) sum[r][v] += column[v] * factor;
    }
  }
  for (int r = 0; r < kRows; ++r) {
    for (int v = 0; v < kTokenVectors; ++v) {
      float* at = target + r * kTokens + v * kLanes;
      store(at, kAccumulate ? load(at) + sum[r][v] : sum[r][v]);
    }
  }
}

template <bool kAccumulate>
inline void product_rows(BroadcastRows a, int rows, int depth, const float* tile, float* target) {
  for (int column = 0; column < kTokens; column += kTokenColumns) {
    BroadcastRows left = a;
    float* at = target + column;
    int row = 0;
    for (; row + kTokenRows <= rows; row += kTokenRows) {
      product_block<kTokenRows, kAccumulate>(left, depth, tile + column, at);
      left.data += kTokenRows * left.row_stride;
      at += kTokenRows * kTokens;
    }
    for (; row < rows; ++row) {
      product_block<1, kAccumulate>(left, depth, tile + column, at);
      left.data += left.row_stride;
      at += kTokens;
    }
  }
}

inline void token_linear(const DenseWeights& layer, const float* tile, Activation activation, float* output) {
  product_rows<false>({layer.matrix, layer.inputs, 1}, layer.outputs, layer.inputs, tile, output);
  for (int row = 0; row < layer.outputs; ++row) {
    for (int at = row * kTokens; at < (row + 1) * kTokens; at += kLanes) {
      const Floats value = load(output + at) + layer.bias[row];
      store(output + at, activation == Activation::relu ? at_least(value, 0.0f) : value);
    }
  }
}

inline void token_norm(const LayerNorm& norm, const float* added, float* tile) {
  const float share = 1.0f / float(norm.width);
  for (int lane = 0; lane < kTokens; lane += kLanes) {
    Floats mean = {}, variance = {};
    for (int k = 0; k < norm.width; ++k) {
      const Floats value = load(tile + k * kTokens + lane) + load(added + k * kTokens + lane);
      store(tile + k * kTokens + lane, value);
      mean += value;
    }
    mean *= share;
    for (int k = 0; k < norm.width; ++k) {
      const Floats centred = load(tile + k * kTokens + lane) - mean;
      variance += centred * centred;
    }
    const Floats inverse = reciprocal_sqrt(variance * share + kLayerNormEpsilon);
    for (int k = 0; k < norm.width; ++k) {
      float* at = tile + k * kTokens + lane;
      store(at, (load(at) - mean) * inverse * norm.weight[k] + norm.bias[k]);
    }
  }
}

// Softmax over keys one tile of keys after the other; sums so far are rescaled when a larger score turns up.
inline void token_attention(const TokenAttention& a, float* query, float* scratch) {
  float* scaled = scratch;                                          // (head_width, kTokens)
  float* scores = scaled + std::ptrdiff_t(a.head_width) * kTokens;  // (kTokens keys, kTokens queries)
  float* largest = scores + kTokens * kTokens;
  float* total = largest + kTokens;
  for (int at = 0; at < a.head_width * kTokens; at += kLanes) {
    store(scaled + at, load(query + at) * a.scale);
    store(query + at, Floats{});
  }
  for (int lane = 0; lane < kTokens; lane += kLanes) {
    store(largest + lane, Floats{} - 3e38f);
    store(total + lane, Floats{});
  }
  for (int first = 0; first < a.count; first += kTokens) {
    const int keys = a.count - first < kTokens ? a.count - first : kTokens;
    const std::ptrdiff_t tile = std::ptrdiff_t(first / kTokens) * a.tile_stride;
    product_rows<false>({a.keys + tile, 1, kTokens}, keys, a.head_width, scaled, scores);
    for (int lane = 0; lane < kTokens; lane += kLanes) {
      const Floats before = load(largest + lane);
      Floats peak = before;
      for (int k = 0; k < keys; ++k) {
        const Floats score = load(scores + k * kTokens + lane);
        peak = score > peak ? score : peak;  // a NaN is left out here and comes back through the exponential
      }
      const Floats shrink = exponential(before - peak);
      Floats sum = load(total + lane) * shrink;
      for (int k = 0; k < keys; ++k) {
        const Floats share = exponential(load(scores + k * kTokens + lane) - peak);
        store(scores + k * kTokens + lane, share);
        sum += share;
      }
      store(largest + lane, peak);
      store(total + lane, sum);
      for (int k = 0; k < a.head_width; ++k) {
        float* at = query + k * kTokens + lane;
        store(at, load(at) * shrink);
      }
    }
    product_rows<true>({a.values + tile, kTokens, 1}, a.head_width, keys, scores, query);
  }
  for (int lane = 0; lane < kTokens; lane += kLanes) {
    const Floats inverse = 1.0f / load(total + lane);
    for (int k = 0; k < a.head_width; ++k) {
      float* at = query + k * kTokens + lane;
      store(at, load(at) * inverse);
    }
  }
}

}  // namespace physkin::PHYSKIN_ISA

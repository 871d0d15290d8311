// Rows of 8-bit network weights on ARM, where products of bytes have instructions of their own (dotprod, i8mm) or not.
// Included by dense_rows.hpp only. All give the same sums, which are exact: integers modulo 2^32, within 32 bits.
#pragma once

namespace physkin::PHYSKIN_ISA {

// Inputs as bytes: an integer q is 256 high + low with signed bytes (kInt8InputLimit). A row of kTogether inputs has the
// high ones and then the low ones.
template <int kTogether>
struct ByteInputs : QuantisedInputs {
  static constexpr int kInputs = kTogether;
  static constexpr Int8Layout kLayout{kTogether, 0};
  static constexpr int kRegistersASum = 2;
  static constexpr int kSumsALoad = 1;
  static constexpr int bytes(int outputs) { return kTogether * outputs; }

  const signed char* rows;

  void prepare(const PackedLayer& layer, const DenseCall& call) {
    signed char* const all = reinterpret_cast<signed char*>(call.quantised);
    const int last = (layer.inputs - 1) / kTogether * kTogether;
    __builtin_memset(all + 2 * last, 0, 2 * kTogether);
    quantise(layer, call.input, [&](int i, Ints rounded) {
      const Ints high = wrapping_sum(rounded, Ints{} + 128) >> 8;
      const int16x8_t halves = vcombine_s16(vmovn_s32((int32x4_t)high), vmovn_s32((int32x4_t)rounded));
      const int8x8_t both = vmovn_s16(halves);
      signed char* const row = all + 2 * (i / kTogether * kTogether) + i % kTogether;
      __builtin_memcpy(row, &both, kLanes);
      __builtin_memcpy(row + kTogether, reinterpret_cast<const signed char*>(&both) + kLanes, kLanes);
    });
    rows = all;
  }

  static Floats value(Ints high, Ints low, const QuantisedInputs& inputs, const PackedLayer& layer, int at) {
    return inputs.value(wrapping_sum(high << 8, low), layer, at);
  }
};

#if defined(__ARM_FEATURE_MATMUL_INT8)

// Rows of eight inputs. One instruction multiplies two outputs' network weights with the high and with the low bytes.
struct Int8Rows : ByteInputs<8> {
  struct Sum {
    int32x4_t first, second;  // of two outputs each: high and low of one, then of the other
  };

  typedef int8x16x2_t Weights;
  static Weights decode(const unsigned char* weights) {
    const int8_t* bytes = reinterpret_cast<const int8_t*>(weights);
    return {{vld1q_s8(bytes), vld1q_s8(bytes + 16)}};
  }
  int8x16_t factor(int row) const { return vld1q_s8(rows + 16 * row); }
  static void multiply_add(Weights weights, int8x16_t both, Sum* sum, int) {
    sum->first = vmmlaq_s32(sum->first, weights.val[0], both);
    sum->second = vmmlaq_s32(sum->second, weights.val[1], both);
  }

  Floats value(Sum sum, const PackedLayer& layer, int at) const {
    return ByteInputs::value((Ints)vuzp1q_s32(sum.first, sum.second), (Ints)vuzp2q_s32(sum.first, sum.second), *this,
                             layer, at);
  }
};

#elif defined(__ARM_FEATURE_DOTPROD)

// Rows of four inputs. One instruction adds the products of four bytes to each of four outputs.
struct Int8Rows : ByteInputs<4> {
  struct Sum {
    int32x4_t high, low;
  };

  typedef int8x16_t Weights;
  static Weights decode(const unsigned char* weights) { return vld1q_s8(reinterpret_cast<const int8_t*>(weights)); }
  int8x8_t factor(int row) const { return vld1_s8(rows + 8 * row); }
  static void multiply_add(Weights weights, int8x8_t both, Sum* sum, int) {
    sum->high = vdotq_lane_s32(sum->high, weights, both, 0);
    sum->low = vdotq_lane_s32(sum->low, weights, both, 1);
  }

  Floats value(Sum sum, const PackedLayer& layer, int at) const {
    return ByteInputs::value((Ints)sum.high, (Ints)sum.low, *this, layer, at);
  }
};

#else

// Rows of two inputs, in 16 bits; those of an output are added up at the end.
struct Int8Rows : PairInputs {
  struct Sum {
    int32x4_t first, second;  // of two outputs each: even and odd inputs of one, then of the other
  };
  static constexpr int kRegistersASum = 2;

  typedef int16x8_t Weights;
  static Weights decode(const unsigned char* weights) {
    return vmovl_s8(vld1_s8(reinterpret_cast<const int8_t*>(weights)));
  }
  int16x8_t factor(int row) const { return vreinterpretq_s16_s32(vdupq_n_s32(pair(row))); }
  static void multiply_add(Weights weights, int16x8_t both, Sum* sum, int) {
    sum->first = vmlal_s16(sum->first, vget_low_s16(weights), vget_low_s16(both));
    sum->second = vmlal_high_s16(sum->second, weights, both);
  }

  Floats value(Sum sum, const PackedLayer& layer, int at) const {
    return QuantisedInputs::value((Ints)vpaddq_s32(sum.first, sum.second), layer, at);
  }
};

#endif

}  // namespace physkin::PHYSKIN_ISA

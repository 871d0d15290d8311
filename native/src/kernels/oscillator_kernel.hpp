// Damped oscillators over a frame, in closed form. Included by kernel_unit.cpp only (see simd.hpp).
#pragma once

#include "kernels/kernels.hpp"
#include "kernels/simd.hpp"

namespace physkin::PHYSKIN_ISA {

// Sine and cosine of |v| < 1e4, absolute error below 2e-7 besides that of the rounding of v (polynomials of Cephes
// sinf).
inline void sine_cosine(Floats v, Floats* sine, Floats* cosine) {
  constexpr float kRound = 12582912.0f;  // 1.5 * 2^23: adding it rounds to an integer in the low bits
  const Floats shifted = v * 0.636619772f + kRound, quarters = shifted - kRound;
  const Floats r = v - quarters * 1.5703125f - quarters * 4.83751297e-4f - quarters * 7.54978995e-8f, z = r * r;
  const Floats s = ((z * -1.9515295891e-4f + 8.3321608736e-3f) * z - 1.6666654611e-1f) * z * r + r;
  const Floats c = ((z * 2.4433157118e-5f - 1.3887316255e-3f) * z + 4.1666645683e-2f) * z * z - z * 0.5f + 1.0f;
  const Ints quarter = (Ints)shifted;
  const Floats in_sine = (quarter & 1) != 0 ? c : s, in_cosine = (quarter & 1) != 0 ? s : c;
  *sine = (quarter & 2) != 0 ? -in_sine : in_sine;
  *cosine = ((quarter + 1) & 2) != 0 ? -in_cosine : in_cosine;
}

void oscillate(const Oscillators& o, const float* driven, float elapsed) {
  for (int k = 0; k < o.count; k += kLanes) {
    const Floats real = load_unaligned(driven + k), imaginary = load_unaligned(driven + o.count + k);
    const Floats rest_real = load(o.rest_real + k), rest_imaginary = load(o.rest_imaginary + k);
    const Floats to_real = real * rest_real - imaginary * rest_imaginary;
    const Floats to_imaginary = real * rest_imaginary + imaginary * rest_real;
    if (elapsed < 0) {
      store(o.real + k, to_real);
      store(o.imaginary + k, to_imaginary);
      continue;
    }
    const Floats gate = 1.0f - 2.0f / (1.0f + exponential(2.0f * load_unaligned(driven + 2 * o.count + k)));  // tanh
    const Floats time = elapsed * exponential(kMostSpeedUp * gate);
    const Floats decay = exponential(-load(o.rates + k) * time);
    Floats sine, cosine;
    sine_cosine(load(o.turns + k) * time, &sine, &cosine);
    const Floats away_real = load(o.real + k) - to_real, away_imaginary = load(o.imaginary + k) - to_imaginary;
    store(o.real + k, to_real + decay * (cosine * away_real - sine * away_imaginary));
    store(o.imaginary + k, to_imaginary + decay * (sine * away_real + cosine * away_imaginary));
  }
}

}  // namespace physkin::PHYSKIN_ISA

// How deep points are in a body's trunk, which limb separation keeps limbs out of. Included by kernel_unit.cpp only (see
// simd.hpp). physkin_core/body_shape/radial_shape.py fits it.
#pragma once

#include "kernels/kernels.hpp"
#include "kernels/simd.hpp"

namespace physkin::PHYSKIN_ISA {

constexpr float kAxisBlur = 0.02f, kRounding = 0.03f, kBelow = 3.0f, kAbove = 1.0f;

struct Place {
  Floats x, y, z;
};

inline Place seen_from(const float* m, Place p) {
  return {m[0] * p.x + m[1] * p.y + m[2] * p.z + m[3], m[4] * p.x + m[5] * p.y + m[6] * p.z + m[7],
          m[8] * p.x + m[9] * p.y + m[10] * p.z + m[11]};
}

// What is above zero, with a rounded corner; and its slope.
inline Floats ramp(Floats excess, Floats& slope) {
  const Floats shifted = at_most(at_least(excess + kRounding, 0.0f), 2 * kRounding);
  slope = shifted * (0.5f / kRounding);
  return shifted * shifted * (0.25f / kRounding) + at_least(excess - kRounding, 0.0f);
}

inline void trunk_depth_of(const TrunkField& field, Place point, Floats* depth, Place* normal) {
  Place at = seen_from(field.back, point);
  Floats turn[9];
  for (int k = 0; k < 9; ++k) turn[k] = Floats{} + field.back[k + k / 3];
  for (int bone = 1; bone < field.bones; ++bone) {
    const float* back = field.back + 12 * bone;
    const Place seen = seen_from(back, point);
    Floats share = 0.5f + (0.5f * (at.z + seen.z) - field.heights[bone]) / field.blend;
    share = at_most(at_least(share, 0.0f), 1.0f);
    share = share * share * (3.0f - 2.0f * share);
    at = {at.x + share * (seen.x - at.x), at.y + share * (seen.y - at.y), at.z + share * (seen.z - at.z)};
    for (int k = 0; k < 9; ++k) turn[k] += share * (back[k + k / 3] - turn[k]);
  }
  const Floats x = at.x - field.x, y = at.y - field.y;
  const Floats squared = x * x + y * y + kAxisBlur * kAxisBlur;
  const Floats inverse = reciprocal_sqrt(squared);
  Floats shrinks, narrows;
  const Floats below = ramp(field.low - at.z, shrinks), above = ramp(at.z - field.high, narrows);
  const float scale = float(field.splines - 2) / (field.high - field.low);
  const Floats cell = at_most(at_least((at.z + below - above - field.low) * scale, 0.0f), float(field.splines - 2));
  // Every quadratic B-spline of height, most of them zero: cheaper than looking up which are not.
  Floats wave[kTrunkWaves] = {}, tilt[kTrunkWaves] = {};
  for (int j = 0; j < field.splines; ++j) {
    const Floats from = cell - (float(j) - 0.5f), far = from < 0.0f ? -from : from;
    const Floats outer = at_least(1.5f - far, 0.0f), inner = at_least(0.5f - far, 0.0f);
    const Floats value = 0.5f * outer * outer - 1.5f * inner * inner, fall = outer - 3.0f * inner;
    const Floats slope = from < 0.0f ? fall : -fall;
    const float* row = field.coefficients + kTrunkWaves * j;
    for (int h = 0; h < kTrunkWaves; ++h) {
      wave[h] += value * row[h];
      tilt[h] += slope * row[h];
    }
  }
  const Floats cosine = x * inverse, sine = y * inverse;
  Floats radius = wave[0], by_height = tilt[0], by_angle = {}, c = Floats{} + 1.0f, s = {};
  for (int h = 1; 2 * h < kTrunkWaves; ++h) {
    const Floats next = c * cosine - s * sine;
    s = s * cosine + c * sine;
    c = next;
    radius += c * wave[2 * h - 1] + s * wave[2 * h];
    by_height += c * tilt[2 * h - 1] + s * tilt[2 * h];
    by_angle += float(h) * (c * wave[2 * h] - s * wave[2 * h - 1]);
  }
  const Floats around = by_angle * inverse * inverse;
  const Floats gx = cosine + around * y, gy = sine - around * x;
  const Floats gz = kAbove * narrows - kBelow * shrinks - by_height * scale * (1.0f - shrinks - narrows);
  // Near the axis the gradient vanishes, as there is no way out to prefer; the steepness does not.
  const Floats steep = reciprocal_sqrt(gx * gx + gy * gy + gz * gz + kAxisBlur * kAxisBlur * inverse * inverse);
  *depth = (radius - squared * inverse - kBelow * below - kAbove * above) * steep;
  *normal = {steep * (turn[0] * gx + turn[3] * gy + turn[6] * gz), steep * (turn[1] * gx + turn[4] * gy + turn[7] * gz),
             steep * (turn[2] * gx + turn[5] * gy + turn[8] * gz)};
}

inline void trunk_depth(const TrunkField& field, const float* points, int count, float* contacts) {
  for (int k = 0; k < count; k += kLanes) {
    const Place point{load(points + k), load(points + count + k), load(points + 2 * count + k)};
    Floats depth;
    Place normal;
    trunk_depth_of(field, point, &depth, &normal);
    store(contacts + k, depth);
    store(contacts + count + k, normal.x);
    store(contacts + 2 * count + k, normal.y);
    store(contacts + 3 * count + k, normal.z);
  }
}

}  // namespace physkin::PHYSKIN_ISA

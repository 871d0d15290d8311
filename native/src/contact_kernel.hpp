// Distances of garment vertices to the posed body. Included by kernel_unit.cpp only (see simd.hpp).
#pragma once

#include "kernels.hpp"
#include "simd.hpp"

namespace physkin::PHYSKIN_ISA {

typedef float Four __attribute__((vector_size(16), may_alias));
typedef float LooseFloat __attribute__((may_alias, aligned(1)));

// x, y and z of four points side by side. Through registers: a wide load of what narrow stores have just written
// would have to wait for them.
inline void store_columns(Four a, Four b, Four c, Four d, float* x, float* y, float* z) {
  const Four ab = __builtin_shufflevector(a, b, 0, 4, 1, 5), cd = __builtin_shufflevector(c, d, 0, 4, 1, 5);
  const Four ab_z = __builtin_shufflevector(a, b, 2, 6, 2, 6), cd_z = __builtin_shufflevector(c, d, 2, 6, 2, 6);
  *reinterpret_cast<Four*>(x) = __builtin_shufflevector(ab, cd, 0, 1, 4, 5);
  *reinterpret_cast<Four*>(y) = __builtin_shufflevector(ab, cd, 2, 3, 6, 7);
  *reinterpret_cast<Four*>(z) = __builtin_shufflevector(ab_z, cd_z, 0, 1, 4, 5);
}

inline Four load_point(const unsigned char* row) {
  const LooseFloat* p = reinterpret_cast<const LooseFloat*>(row);
  return Four{p[0], p[1], p[2], 0.0f};
}

inline int find_near(const ContactBlocks& blocks, const float* posed, const VertexRows& rows, float limit,
                     NearVertex* near) {
  int found = 0;
  for (int block = 0; block < blocks.block_count; ++block) {
    const std::int32_t* vertex = blocks.vertex + block * kBlock;
    alignas(64) float place[3][kBlock];
    for (int lane = 0; lane < kBlock; lane += 4) {
      Four point[4];
      for (int k = 0; k < 4; ++k) {
        point[k] = load_point(rows.data + vertex[lane + k] * rows.stride * std::ptrdiff_t(sizeof(float)));
      }
      store_columns(point[0], point[1], point[2], point[3], place[0] + lane, place[1] + lane, place[2] + lane);
    }
    const std::int32_t start = blocks.candidate_start[block], end = blocks.candidate_start[block + 1];
    Ints any = {};
    alignas(64) float estimate[kBlock];
    alignas(64) std::int32_t nearest[kBlock];
    for (int lane = 0; lane < kBlock; lane += kLanes) {
      const Floats x = load(place[0] + lane), y = load(place[1] + lane), z = load(place[2] + lane);
      // Two searches side by side: each comparison waits for the one before it.
      Floats best[2], height[2];
      Ints index[2] = {};
      for (int u = 0; u < 2; ++u) best[u] = height[u] = Floats{} + 3e38f;
      for (std::int32_t at = start; at < end; at += 2) {
        for (int u = 0; u < 2; ++u) {
          const std::int32_t candidate = blocks.candidate[at + u];
          const float* body = posed + std::ptrdiff_t(candidate) * kBodyRow;
          const Floats dx = x - body[0], dy = y - body[1], dz = z - body[2];
          const Floats square = dx * dx + dy * dy + dz * dz;
          const Floats above = dx * body[3] + dy * body[4] + dz * body[5] + square * body[6];
          const Ints closer = square < best[u];
          best[u] = closer ? square : best[u];
          height[u] = closer ? above : height[u];
          index[u] = closer ? Ints{} + candidate : index[u];
        }
      }
      const Ints other = best[1] < best[0];
      const Floats lower = other ? height[1] : height[0];
      any |= lower < limit;
      store(estimate + lane, lower);
      *reinterpret_cast<Ints*>(nearest + lane) = other ? index[1] : index[0];
    }
    int found_here = 0;
    for (int lane = 0; lane < kLanes; ++lane) found_here |= any[lane];
    if (!found_here) continue;  // most blocks hang clear of the body
    for (int lane = 0; lane < blocks.count[block]; ++lane) {
      near[found] = {vertex[lane], nearest[lane]};
      found += estimate[lane] < limit;
    }
  }
  return found;
}

// A vector of at most kPatch lanes.
constexpr int kPatchLanes = kLanes < kPatch ? kLanes : kPatch;
typedef float PatchFloats __attribute__((vector_size(4 * kPatchLanes), may_alias));
typedef std::int32_t PatchInts __attribute__((vector_size(4 * kPatchLanes)));

inline PatchFloats load_patch(const float* p) { return *reinterpret_cast<const PatchFloats*>(p); }
inline PatchFloats unit_interval(PatchFloats v) {
  v = v < 0.0f ? PatchFloats{} : v;
  return v > 1.0f ? PatchFloats{} + 1.0f : v;
}
inline PatchFloats dot(const PatchFloats* p, const PatchFloats* q) { return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]; }

// Lanes are triangles: the projection onto each if it falls inside, else the best point of its three sides.
inline PatchPoint closest_on_patch(const std::int32_t* patch, const float* posed, const float* point) {
  alignas(64) float corner[9][kPatch];
  for (int t = 0; t < kPatch; t += 4) {
    for (int k = 0; k < 3; ++k) {
      Four at[4];
      for (int i = 0; i < 4; ++i) {
        at[i] = *reinterpret_cast<const Four*>(posed + std::ptrdiff_t(patch[3 * (t + i) + k]) * kBodyRow);
      }
      store_columns(at[0], at[1], at[2], at[3], corner[3 * k] + t, corner[3 * k + 1] + t, corner[3 * k + 2] + t);
    }
  }
  alignas(64) float squares[kPatch], second[kPatch], third[kPatch];
  for (int lane = 0; lane < kPatch; lane += kPatchLanes) {
    PatchFloats ab[3], ac[3], ap[3];
    for (int c = 0; c < 3; ++c) {
      const PatchFloats a = load_patch(corner[c] + lane);
      ab[c] = load_patch(corner[3 + c] + lane) - a;
      ac[c] = load_patch(corner[6 + c] + lane) - a;
      ap[c] = point[c] - a;
    }
    const PatchFloats zero = {}, one = zero + 1.0f, tiny = zero + 1e-12f;
    const PatchFloats aa = dot(ab, ab), bb = dot(ac, ac), mixed = dot(ab, ac), pa = dot(ab, ap), pb = dot(ac, ap);
    const PatchFloats area = aa * bb - mixed * mixed, cc = aa - 2.0f * mixed + bb;
    const PatchFloats inverse = one / (area < 1e-20f ? zero + 1e-20f : area);
    const PatchFloats v_in = (bb * pa - mixed * pb) * inverse, w_in = (aa * pb - mixed * pa) * inverse;
    const PatchFloats along_ab = unit_interval(pa / (aa < tiny ? tiny : aa));
    const PatchFloats along_ac = unit_interval(pb / (bb < tiny ? tiny : bb));
    const PatchFloats along_bc = unit_interval((aa - mixed - pa + pb) / (cc < tiny ? tiny : cc));
    const PatchInts inside = (v_in >= 0.0f) & (w_in >= 0.0f) & (v_in + w_in <= 1.0f);

    // |ap - v ab - w ac|^2 from the products alone; what is lost to rounding is far below the sides' differences.
    const PatchFloats pp = dot(ap, ap);
    const PatchFloats on_ab = pp + along_ab * (along_ab * aa - 2.0f * pa);
    const PatchFloats on_ac = pp + along_ac * (along_ac * bb - 2.0f * pb);
    const PatchFloats along_cb = one - along_bc;
    const PatchFloats on_bc = pp + along_cb * (along_cb * aa - 2.0f * pa) + along_bc * (along_bc * bb - 2.0f * pb) +
                              2.0f * along_cb * along_bc * mixed;
    const PatchFloats within = pp - v_in * pa - w_in * pb;
    const PatchInts ac_first = on_ac < on_ab;
    PatchFloats side = ac_first ? on_ac : on_ab;
    PatchFloats v = ac_first ? zero : along_ab, w = ac_first ? along_ac : zero;
    const PatchInts bc_first = on_bc < side;
    side = bc_first ? on_bc : side;
    v = bc_first ? along_cb : v;
    w = bc_first ? along_bc : w;
    *reinterpret_cast<PatchFloats*>(squares + lane) = inside ? within : side;
    *reinterpret_cast<PatchFloats*>(second + lane) = inside ? v_in : v;
    *reinterpret_cast<PatchFloats*>(third + lane) = inside ? w_in : w;
  }
  int best = 0;
  for (int t = 1; t < kPatch; ++t) best = squares[t] < squares[best] ? t : best;
  return {best, second[best], third[best]};
}

}  // namespace physkin::PHYSKIN_ISA

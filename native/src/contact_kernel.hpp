// Distances of garment vertices to the posed body. Included by kernel_unit.cpp only (see simd.hpp).
#pragma once

#include "kernels.hpp"
#include "simd.hpp"

namespace physkin::PHYSKIN_ISA {

typedef float Four __attribute__((vector_size(16), may_alias));
typedef float LooseFloat __attribute__((may_alias, aligned(1)));

// Columns are put together in registers throughout: a wide load of what narrow stores have just written would have to
// wait for them.
typedef float Eight __attribute__((vector_size(32), may_alias));
typedef float Sixteen __attribute__((vector_size(64), may_alias));

// Vectors 2 * kPair and 2 * kPair + 1.
template <int kPair>
inline Eight join_pair(const Four* v) {
  return (Eight)__builtin_shufflevector(v[2 * kPair], v[2 * kPair + 1], 0, 1, 2, 3, 4, 5, 6, 7);
}

// kCount vectors of four, one after the other.
template <int kCount>
inline auto join(const Four* v) {
  static_assert(kCount == 1 || kCount == 2 || kCount == 4);
  if constexpr (kCount == 1) {
    return v[0];
  } else if constexpr (kCount == 2) {
    return join_pair<kCount - 2>(v);
  } else {
    return (Sixteen)__builtin_shufflevector(join_pair<kCount - 4>(v), join_pair<kCount - 3>(v), 0, 1, 2, 3, 4, 5, 6, 7,
                                            8, 9, 10, 11, 12, 13, 14, 15);
  }
}

// Columns of 4 * kFours rows of at least four floats, the k-th at row(k).
template <int kFours>
struct Columns {
  Four column[4][kFours];

  template <class Row>
  explicit Columns(Row row) {
    for (int k = 0; k < kFours; ++k) {
      const Four a = row(4 * k), b = row(4 * k + 1), c = row(4 * k + 2), d = row(4 * k + 3);
      const Four ab = __builtin_shufflevector(a, b, 0, 4, 1, 5), cd = __builtin_shufflevector(c, d, 0, 4, 1, 5);
      const Four ab_high = __builtin_shufflevector(a, b, 2, 6, 3, 7);
      const Four cd_high = __builtin_shufflevector(c, d, 2, 6, 3, 7);
      column[0][k] = __builtin_shufflevector(ab, cd, 0, 1, 4, 5);
      column[1][k] = __builtin_shufflevector(ab, cd, 2, 3, 6, 7);
      column[2][k] = __builtin_shufflevector(ab_high, cd_high, 0, 1, 4, 5);
      column[3][k] = __builtin_shufflevector(ab_high, cd_high, 2, 3, 6, 7);
    }
  }
  auto operator[](int k) const { return join<kFours>(column[k]); }
};

inline Four load_point(const unsigned char* row) {
  const LooseFloat* p = reinterpret_cast<const LooseFloat*>(row);
  return Four{p[0], p[1], p[2], 0.0f};
}

// Distance squared of kLanes points to each of some body vertices in turn; the nearest one's place in the list.
inline Ints nearest_place(Floats x, Floats y, Floats z, const std::int32_t* candidate, int count, const float* posed) {
  // The place lies in the low bits of the squared distance, so that one integer minimum keeps both: positive floats
  // are in the order of their bits. What this rounds off a distance is a thousandth of a per cent.
  Ints least[2] = {Ints{} + 0x7f800000, Ints{} + 0x7f800000};
  Ints place[2] = {Ints{}, Ints{} + 1};
  for (int at = 0; at < count; at += 2) {  // two minima side by side: each waits for the one before it
    for (int u = 0; u < 2; ++u) {
      const float* body = posed + std::ptrdiff_t(candidate[at + u]) * kBodyRow;
      const Floats dx = x - body[0], dy = y - body[1], dz = z - body[2];
      const Ints key = ((Ints)(dx * dx + dy * dy + dz * dz) & ~(kMaxCandidates - 1)) | place[u];
      least[u] = key < least[u] ? key : least[u];
      place[u] += 2;
    }
  }
  return (least[0] < least[1] ? least[0] : least[1]) & (kMaxCandidates - 1);
}

inline int find_near(const ContactBlocks& blocks, const float* posed, const VertexRows& rows, float limit,
                     NearVertex* near) {
  int found = 0;
  for (int block = 0; block < blocks.block_count; ++block) {
    const std::int32_t start = blocks.candidate_start[block];
    const int count = blocks.candidate_start[block + 1] - start;
    if (count == 0) continue;
    const std::int32_t* vertex = blocks.vertex + block * kBlock;
    const std::int32_t* candidate = blocks.candidate + start;
    alignas(64) float estimate[kBlock];
    alignas(64) std::int32_t nearest[kBlock];
    Ints any = {};
    for (int lane = 0; lane < kBlock; lane += kLanes) {
      const Columns<kLanes / 4> point([&](int k) {
        return load_point(rows.data + vertex[lane + k] * rows.stride * std::ptrdiff_t(sizeof(float)));
      });
      const Floats x = point[0], y = point[1], z = point[2];
      *reinterpret_cast<StoredInts*>(nearest + lane) = nearest_place(x, y, z, candidate, count, posed);
      for (int k = lane; k < lane + kLanes; ++k) nearest[k] = candidate[nearest[k]];
      const auto row = [&](int k) { return posed + std::ptrdiff_t(nearest[lane + k]) * kBodyRow; };
      const Columns<kLanes / 4> front([&](int k) { return *reinterpret_cast<const Four*>(row(k)); });
      const Columns<kLanes / 4> back([&](int k) { return *reinterpret_cast<const Four*>(row(k) + 4); });
      const Floats dx = x - front[0], dy = y - front[1], dz = z - front[2];
      const Floats square = dx * dx + dy * dy + dz * dz;
      const Floats height = dx * front[3] + dy * back[0] + dz * back[1] + square * back[2];
      any |= height < limit;
      store(estimate + lane, height);
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
typedef std::int32_t StoredPatchInts __attribute__((vector_size(4 * kPatchLanes), may_alias));

inline PatchFloats unit_interval(PatchFloats v) {
  v = v < 0.0f ? PatchFloats{} : v;
  return v > 1.0f ? PatchFloats{} + 1.0f : v;
}
inline PatchFloats dot(const PatchFloats* p, const PatchFloats* q) { return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]; }

// Lanes are triangles: the projection onto each if it falls inside, else the best point of its three sides.
inline PatchPoint closest_on_patch(const std::int32_t* patch, const float* posed, const float* point) {
  alignas(64) float second[kPatch], third[kPatch];
  alignas(64) std::int32_t keys[kPatch];
  for (int lane = 0; lane < kPatch; lane += kPatchLanes) {
    const auto corner = [&](int c) {
      return Columns<kPatchLanes / 4>([&](int k) {
        return *reinterpret_cast<const Four*>(posed + std::ptrdiff_t(patch[3 * (lane + k) + c]) * kBodyRow);
      });
    };
    const auto first = corner(0), next = corner(1), last = corner(2);
    PatchFloats ab[3], ac[3], ap[3];
    for (int c = 0; c < 3; ++c) {
      const PatchFloats a = first[c];
      ab[c] = next[c] - a;
      ac[c] = last[c] - a;
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
    const PatchFloats square = inside ? within : side;
    const PatchInts bits = (PatchInts)(square < 0.0f ? zero : square);  // rounding may have left it below
    *reinterpret_cast<StoredPatchInts*>(keys + lane) = bits & ~(kPatch - 1);
    *reinterpret_cast<PatchFloats*>(second + lane) = inside ? v_in : v;
    *reinterpret_cast<PatchFloats*>(third + lane) = inside ? w_in : w;
  }
  std::int32_t least = keys[0];  // the triangle in the low bits, as in nearest_place: nothing to foresee
  for (int t = 1; t < kPatch; ++t) least = (keys[t] | t) < least ? (keys[t] | t) : least;
  const int best = least & (kPatch - 1);
  return {best, second[best], third[best]};
}

}  // namespace physkin::PHYSKIN_ISA

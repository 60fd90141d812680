#pragma once

/// Several numbers in one register, and the 4 x 4 transpositions that bring records of numbers into
/// that form and back.
///
/// Included only by files that are compiled once for each instruction set, each time with a
/// separate namespace, BUNDLE_ISA. Two copies of an inline function compiled for different
/// instruction sets must never share a name, because the linker keeps only one of them. For the
/// same reason, no code here, and no code that these kernels call, uses an inline function of the
/// standard library.

#include <cstdint>

namespace bundle::BUNDLE_ISA {

inline constexpr int kLanes = BUNDLE_LANES;  // a multiple of 4

/// Four doubles: the unit of matrix rows.
using Quad = double __attribute__((vector_size(32)));

inline Quad LoadQuad(const double* from) {
  Quad quad;
  __builtin_memcpy(&quad, from, sizeof quad);
  return quad;
}

inline void StoreQuad(const Quad& quad, double* to) { __builtin_memcpy(to, &quad, sizeof quad); }

/// One double of each lane; arithmetic is lane by lane.
struct Pack {
  using Vector = double __attribute__((vector_size(8 * kLanes)));
  using Bits = int64_t __attribute__((vector_size(8 * kLanes)));

  Vector v;

  Pack() = default;
  Pack(double x) : v(x - Vector{}) {}  // NOLINT: implicit, as from int to double
  explicit Pack(const Vector& vector) : v(vector) {}

  Pack& operator+=(const Pack& o) { return v += o.v, *this; }
  Pack& operator*=(const Pack& o) { return v *= o.v, *this; }
  Pack operator-() const { return Pack(-v); }
  friend Pack operator+(const Pack& a, const Pack& b) { return Pack(a.v + b.v); }
  friend Pack operator-(const Pack& a, const Pack& b) { return Pack(a.v - b.v); }
  friend Pack operator*(const Pack& a, const Pack& b) { return Pack(a.v * b.v); }
  friend Pack operator/(const Pack& a, const Pack& b) { return Pack(a.v / b.v); }
};

/// A boolean for each lane.
struct Mask {
  Pack::Bits bits;

  friend Mask operator|(const Mask& a, const Mask& b) { return {a.bits | b.bits}; }
  friend Mask operator&(const Mask& a, const Mask& b) { return {a.bits & b.bits}; }
  Mask operator~() const { return {~bits}; }
};

inline Mask operator<=(const Pack& a, const Pack& b) { return {a.v <= b.v}; }
inline Mask operator>=(const Pack& a, const Pack& b) { return {a.v >= b.v}; }
inline Mask operator>(const Pack& a, const Pack& b) { return {a.v > b.v}; }

inline Pack Select(const Mask& mask, const Pack& yes, const Pack& no) {
  return Pack(mask.bits ? yes.v : no.v);
}

inline bool All(const Mask& mask) {
  int64_t all = -1;
  for (int i = 0; i < kLanes; ++i) all &= mask.bits[i];
  return all != 0;
}

inline Pack Sqrt(const Pack& x) {
  Pack root;
  for (int i = 0; i < kLanes; ++i) root.v[i] = __builtin_sqrt(x.v[i]);
  return root;
}

inline Pack Max(const Pack& a, const Pack& b) { return Select(a >= b, a, b); }

// Clang has only the first, GCC before version 12 only the second; both give the number of entries.
#ifdef __has_builtin
#if __has_builtin(__builtin_shufflevector)
#define BUNDLE_SHUFFLE(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#endif
#endif
#ifndef BUNDLE_SHUFFLE
using QuadIndex = int64_t __attribute__((vector_size(32)));
#define BUNDLE_SHUFFLE(a, b, ...) __builtin_shuffle(a, b, QuadIndex{__VA_ARGS__})
#endif

/// Transposes four rows of four.
inline void Transpose(Quad* rows) {
  const Quad ab_even = BUNDLE_SHUFFLE(rows[0], rows[1], 0, 4, 2, 6);
  const Quad ab_odd = BUNDLE_SHUFFLE(rows[0], rows[1], 1, 5, 3, 7);
  const Quad cd_even = BUNDLE_SHUFFLE(rows[2], rows[3], 0, 4, 2, 6);
  const Quad cd_odd = BUNDLE_SHUFFLE(rows[2], rows[3], 1, 5, 3, 7);
  rows[0] = BUNDLE_SHUFFLE(ab_even, cd_even, 0, 1, 4, 5);
  rows[1] = BUNDLE_SHUFFLE(ab_odd, cd_odd, 0, 1, 4, 5);
  rows[2] = BUNDLE_SHUFFLE(ab_even, cd_even, 2, 3, 6, 7);
  rows[3] = BUNDLE_SHUFFLE(ab_odd, cd_odd, 2, 3, 6, 7);
}

#undef BUNDLE_SHUFFLE

/// packs[j] = entry j of each lane's record; `count` a multiple of 4.
inline void GatherRecords(const double* const* records, int count, Pack* packs) {
  for (int j = 0; j < count; j += 4) {
    for (int lane = 0; lane < kLanes; lane += 4) {
      Quad rows[4];
      for (int i = 0; i < 4; ++i) rows[i] = LoadQuad(records[lane + i] + j);
      Transpose(rows);
      for (int i = 0; i < 4; ++i) {
        __builtin_memcpy(reinterpret_cast<double*>(&packs[j + i].v) + lane, &rows[i], sizeof(Quad));
      }
    }
  }
}

/// Entries 0 to 3 of each lane's record = packs[0] to packs[3].
inline void ScatterRecords(const Pack* const* packs, double* const* records, int entry) {
  for (int lane = 0; lane < kLanes; lane += 4) {
    Quad rows[4];
    for (int i = 0; i < 4; ++i) {
      __builtin_memcpy(&rows[i], reinterpret_cast<const double*>(&packs[i]->v) + lane,
                       sizeof(Quad));
    }
    Transpose(rows);
    for (int i = 0; i < 4; ++i) StoreQuad(rows[i], records[lane + i] + entry);
  }
}

}  // namespace bundle::BUNDLE_ISA

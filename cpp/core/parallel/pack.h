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

/// Two or three numbers, which may be the last of an array, and padding.
inline Quad LoadPair(const double* from) { return Quad{from[0], from[1]}; }
inline Quad LoadTriple(const double* from) { return Quad{from[0], from[1], from[2]}; }

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
#define BUNDLE_CHANGES_WIDTH
#endif
#endif
#ifndef BUNDLE_SHUFFLE
#define BUNDLE_SHUFFLE(a, b, ...) __builtin_shuffle(a, b, Pack::Bits{__VA_ARGS__})
#endif

/// Row i of the square of lanes 0 to 3 and, of eight lanes, row i of the square of lanes 4 to 7.
using SquareRow = Pack::Vector;

/// The rows of a lane and of the lane four further on are joined and split in registers: a load
/// that spans two stores waits until both have reached the cache.
#if BUNDLE_LANES == 8 && defined(BUNDLE_CHANGES_WIDTH)
inline SquareRow JoinRows(const Quad* rows) {
  return BUNDLE_SHUFFLE(rows[0], rows[4], 0, 1, 2, 3, 4, 5, 6, 7);
}
inline void SplitRows(const SquareRow& both, Quad* rows) {
  rows[0] = BUNDLE_SHUFFLE(both, both, 0, 1, 2, 3);
  rows[4] = BUNDLE_SHUFFLE(both, both, 4, 5, 6, 7);
}
#else
inline SquareRow JoinRows(const Quad* rows) {
  SquareRow both;
  for (int lane = 0; lane < kLanes; lane += 4) {
    __builtin_memcpy(reinterpret_cast<double*>(&both) + lane, rows + lane, sizeof(Quad));
  }
  return both;
}
inline void SplitRows(const SquareRow& both, Quad* rows) {
  for (int lane = 0; lane < kLanes; lane += 4) {
    __builtin_memcpy(rows + lane, reinterpret_cast<const double*>(&both) + lane, sizeof(Quad));
  }
}
#endif

/// Transposes each square of four rows.
#if defined(__AVX__)
inline void TransposeSquares(SquareRow* rows) {
#if BUNDLE_LANES == 8
#define BUNDLE_EVEN 0, 8, 2, 10, 4, 12, 6, 14
#define BUNDLE_ODD 1, 9, 3, 11, 5, 13, 7, 15
#define BUNDLE_FIRST_PAIRS 0, 1, 8, 9, 4, 5, 12, 13
#define BUNDLE_LAST_PAIRS 2, 3, 10, 11, 6, 7, 14, 15
#else
#define BUNDLE_EVEN 0, 4, 2, 6
#define BUNDLE_ODD 1, 5, 3, 7
#define BUNDLE_FIRST_PAIRS 0, 1, 4, 5
#define BUNDLE_LAST_PAIRS 2, 3, 6, 7
#endif
  const SquareRow ab_even = BUNDLE_SHUFFLE(rows[0], rows[1], BUNDLE_EVEN);
  const SquareRow ab_odd = BUNDLE_SHUFFLE(rows[0], rows[1], BUNDLE_ODD);
  const SquareRow cd_even = BUNDLE_SHUFFLE(rows[2], rows[3], BUNDLE_EVEN);
  const SquareRow cd_odd = BUNDLE_SHUFFLE(rows[2], rows[3], BUNDLE_ODD);
  rows[0] = BUNDLE_SHUFFLE(ab_even, cd_even, BUNDLE_FIRST_PAIRS);
  rows[1] = BUNDLE_SHUFFLE(ab_odd, cd_odd, BUNDLE_FIRST_PAIRS);
  rows[2] = BUNDLE_SHUFFLE(ab_even, cd_even, BUNDLE_LAST_PAIRS);
  rows[3] = BUNDLE_SHUFFLE(ab_odd, cd_odd, BUNDLE_LAST_PAIRS);
#undef BUNDLE_EVEN
#undef BUNDLE_ODD
#undef BUNDLE_FIRST_PAIRS
#undef BUNDLE_LAST_PAIRS
}
#else  // registers of two doubles
inline void TransposeSquares(SquareRow* rows) {
  using Pair = double __attribute__((vector_size(16)));
  Pair from[4][2], to[4][2];
  __builtin_memcpy(from, rows, sizeof from);
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j) {
      const Pair &a = from[2 * i][j], &b = from[2 * i + 1][j];
      to[2 * j][i] = Pair{a[0], b[0]};
      to[2 * j + 1][i] = Pair{a[1], b[1]};
    }
  }
  __builtin_memcpy(rows, to, sizeof to);
}
#endif

#undef BUNDLE_SHUFFLE
#undef BUNDLE_CHANGES_WIDTH

/// packs[j] = entry j of the row of each lane, for j in [0, 4).
inline void PacksOfRows(const Quad* rows, Pack* packs) {
  SquareRow square[4];
  for (int i = 0; i < 4; ++i) square[i] = JoinRows(rows + i);
  TransposeSquares(square);
  for (int i = 0; i < 4; ++i) packs[i].v = square[i];
}

/// packs[j] = entry j of each lane's record; `count` a multiple of 4.
inline void GatherRecords(const double* const* records, int count, Pack* packs) {
  for (int j = 0; j < count; j += 4) {
    Quad rows[kLanes];
    for (int lane = 0; lane < kLanes; ++lane) rows[lane] = LoadQuad(records[lane] + j);
    PacksOfRows(rows, packs + j);
  }
}

/// Entries 0 to 3 of each lane's record = packs[0] to packs[3].
inline void ScatterRecords(const Pack* const* packs, double* const* records, int entry) {
  SquareRow square[4];
  for (int i = 0; i < 4; ++i) square[i] = packs[i]->v;
  TransposeSquares(square);
  Quad rows[kLanes];
  for (int i = 0; i < 4; ++i) SplitRows(square[i], rows + i);
  for (int lane = 0; lane < kLanes; ++lane) StoreQuad(rows[lane], records[lane] + entry);
}

/// packs[0], packs[1] = the two numbers of each lane.
inline void GatherPairs(const double* const* pairs, Pack* packs) {
  Quad rows[kLanes];
  for (int lane = 0; lane < kLanes; ++lane) rows[lane] = LoadPair(pairs[lane]);
  Pack four[4];
  PacksOfRows(rows, four);
  packs[0] = four[0];
  packs[1] = four[1];
}

/// packs[0] to packs[2] = the three numbers of each lane.
inline void GatherTriples(const double* const* triples, Pack* packs) {
  Quad rows[kLanes];
  for (int lane = 0; lane < kLanes; ++lane) rows[lane] = LoadTriple(triples[lane]);
  Pack four[4];
  PacksOfRows(rows, four);
  for (int i = 0; i < 3; ++i) packs[i] = four[i];
}

}  // namespace bundle::BUNDLE_ISA

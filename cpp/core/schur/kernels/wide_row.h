#pragma once

/// Rows of matrices in registers. Included by kernels.cpp only.

#include "core/parallel/pack.h"

namespace bundle::BUNDLE_ISA {

/// Doubles of the widest register.
inline constexpr int kWide =
#if defined(__AVX__)
    kLanes;
#else
    2;
#endif

/// True if a product is added before it is rounded.
inline constexpr bool kFuses =
#if defined(__FMA__) || defined(__aarch64__)
    true;
#else
    false;
#endif

/// A row of kQuads quads in the widest registers of the instruction set.
template <int kQuads>
struct WideRow {
  using Wide = double __attribute__((vector_size(8 * kWide)));
  static constexpr int kWides = 4 * kQuads / kWide;
  static constexpr int kRest = kQuads - kWides * kWide / 4;
  Wide wide[kWides > 0 ? kWides : 1];
  Quad quad[kRest > 0 ? kRest : 1];

  static WideRow Load(const double* from) {
    WideRow row;
#pragma GCC unroll 16
    for (int k = 0; k < kWides; ++k) {
      __builtin_memcpy(&row.wide[k], from + kWide * k, sizeof(Wide));
    }
#pragma GCC unroll 8
    for (int k = 0; k < kRest; ++k) row.quad[k] = LoadQuad(from + kWide * kWides + 4 * k);
    return row;
  }
  void Store(double* to) const {
#pragma GCC unroll 16
    for (int k = 0; k < kWides; ++k) __builtin_memcpy(to + kWide * k, &wide[k], sizeof(Wide));
#pragma GCC unroll 8
    for (int k = 0; k < kRest; ++k) StoreQuad(quad[k], to + kWide * kWides + 4 * k);
  }
  /// -= factor * row
  void Subtract(double factor, const WideRow& row) {
#pragma GCC unroll 16
    for (int k = 0; k < kWides; ++k) wide[k] -= factor * row.wide[k];
#pragma GCC unroll 8
    for (int k = 0; k < kRest; ++k) quad[k] -= factor * row.quad[k];
  }
  /// += factor * row
  void Add(double factor, const WideRow& row) {
#pragma GCC unroll 16
    for (int k = 0; k < kWides; ++k) wide[k] += factor * row.wide[k];
#pragma GCC unroll 8
    for (int k = 0; k < kRest; ++k) quad[k] += factor * row.quad[k];
  }
  /// += row * row, number by number
  void AddSquares(const WideRow& row) {
#pragma GCC unroll 16
    for (int k = 0; k < kWides; ++k) wide[k] += row.wide[k] * row.wide[k];
#pragma GCC unroll 8
    for (int k = 0; k < kRest; ++k) quad[k] += row.quad[k] * row.quad[k];
  }
  /// += term, whose last bits are set to 1 first if `last_bit` is 1 (ChunkSum::last_bit)
  void AddTerm(const WideRow& term, int64_t last_bit) {
    using Bits = int64_t __attribute__((vector_size(8 * kWide)));
    using QuadBits = int64_t __attribute__((vector_size(sizeof(Quad))));
#pragma GCC unroll 16
    for (int k = 0; k < kWides; ++k) {
      wide[k] += reinterpret_cast<Wide>(reinterpret_cast<Bits>(term.wide[k]) | last_bit);
    }
#pragma GCC unroll 8
    for (int k = 0; k < kRest; ++k) {
      quad[k] += reinterpret_cast<Quad>(reinterpret_cast<QuadBits>(term.quad[k]) | last_bit);
    }
  }
  /// += factor_0 * row_0 + factor_1 * row_1, a term of a block; `last_bit` as in AddTerm
  void AddTwo(double factor_0, const WideRow& row_0, double factor_1, const WideRow& row_1,
              int64_t last_bit) {
    if constexpr (kFuses) {
      Add(factor_0, row_0);
      Add(factor_1, row_1);
    } else {
      WideRow term = {};
      term.Add(factor_0, row_0);
      term.Add(factor_1, row_1);
      AddTerm(term, last_bit);
    }
  }
  /// += row_0 * row_0 + row_1 * row_1, number by number, a term likewise
  void AddTwoSquares(const WideRow& row_0, const WideRow& row_1, int64_t last_bit) {
    if constexpr (kFuses) {
      AddSquares(row_0);
      AddSquares(row_1);
    } else {
      WideRow term = {};
      term.AddSquares(row_0);
      term.AddSquares(row_1);
      AddTerm(term, last_bit);
    }
  }
  /// The product with a row, in four parts.
  Quad Times(const WideRow& row) const {
    double products[4 * kQuads];
    WideRow both;
    for (int k = 0; k < kWides; ++k) both.wide[k] = wide[k] * row.wide[k];
    for (int k = 0; k < kRest; ++k) both.quad[k] = quad[k] * row.quad[k];
    both.Store(products);
    Quad sum = {};
    for (int k = 0; k < kQuads; ++k) sum += LoadQuad(products + 4 * k);
    return sum;
  }
};

/// The first eight numbers of a column of a block with rows of 12. Sums begin with the values of
/// the block, because on a grid (assembly/sum_grid.h) every product must be rounded to the grid.
inline WideRow<2> LoadColumn(const double* column) {
  double numbers[8];
  for (int r = 0; r < 8; ++r) numbers[r] = column[12 * r];
  return WideRow<2>::Load(numbers);
}

}  // namespace bundle::BUNDLE_ISA

#pragma once

/// Rows of matrices in registers. Included by kernels.cpp only.

#include "core/parallel/pack.h"

namespace bundle::BUNDLE_ISA {

/// A row of kQuads quads in the widest registers of the instruction set.
template <int kQuads>
struct WideRow {
  static constexpr int kOcts = kLanes == 8 ? kQuads / 2 : 0;
  static constexpr int kRest = kQuads - 2 * kOcts;
  using Oct = double __attribute__((vector_size(64)));
  Oct oct[kOcts > 0 ? kOcts : 1];
  Quad quad[kRest > 0 ? kRest : 1];

  static WideRow Load(const double* from) {
    WideRow row;
#pragma GCC unroll 4
    for (int k = 0; k < kOcts; ++k) __builtin_memcpy(&row.oct[k], from + 8 * k, sizeof(Oct));
#pragma GCC unroll 8
    for (int k = 0; k < kRest; ++k) row.quad[k] = LoadQuad(from + 8 * kOcts + 4 * k);
    return row;
  }
  void Store(double* to) const {
#pragma GCC unroll 4
    for (int k = 0; k < kOcts; ++k) __builtin_memcpy(to + 8 * k, &oct[k], sizeof(Oct));
#pragma GCC unroll 8
    for (int k = 0; k < kRest; ++k) StoreQuad(quad[k], to + 8 * kOcts + 4 * k);
  }
  /// -= factor * row
  void Subtract(double factor, const WideRow& row) {
#pragma GCC unroll 4
    for (int k = 0; k < kOcts; ++k) oct[k] -= factor * row.oct[k];
#pragma GCC unroll 8
    for (int k = 0; k < kRest; ++k) quad[k] -= factor * row.quad[k];
  }
  /// += factor * row
  void Add(double factor, const WideRow& row) {
#pragma GCC unroll 4
    for (int k = 0; k < kOcts; ++k) oct[k] += factor * row.oct[k];
#pragma GCC unroll 8
    for (int k = 0; k < kRest; ++k) quad[k] += factor * row.quad[k];
  }
  /// += row * row, number by number
  void AddSquares(const WideRow& row) {
#pragma GCC unroll 4
    for (int k = 0; k < kOcts; ++k) oct[k] += row.oct[k] * row.oct[k];
#pragma GCC unroll 8
    for (int k = 0; k < kRest; ++k) quad[k] += row.quad[k] * row.quad[k];
  }
  /// The product with a row, in four parts.
  Quad Times(const WideRow& row) const {
    Quad sum = {};
#pragma GCC unroll 4
    for (int k = 0; k < kOcts; ++k) {
      Quad half[2];
      const Oct product = oct[k] * row.oct[k];
      __builtin_memcpy(half, &product, sizeof product);
      sum += half[0] + half[1];
    }
#pragma GCC unroll 8
    for (int k = 0; k < kRest; ++k) sum += quad[k] * row.quad[k];
    return sum;
  }
};

}  // namespace bundle::BUNDLE_ISA

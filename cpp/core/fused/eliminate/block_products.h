#pragma once

/// Sums of products of two rows, the arithmetic of the elimination; kernels_impl.h says how to
/// include this.
///
/// Everything comes in two rows, those of x and of y of an observation, each padded with zeros to
/// whole quads, of which there are kQuads.

#include "core/fused/eliminate/pack.h"

namespace bundle::fused::BUNDLE_ISA {

/// The two rows of a record in registers, to be multiplied from the left.
template <int kQuads>
struct RightFactor {
  Quad row_0[kQuads], row_1[kQuads];

  explicit RightFactor(const double* rows) {
    for (int q = 0; q < kQuads; ++q) {
      row_0[q] = LoadQuad(rows + 4 * q);
      row_1[q] = LoadQuad(rows + 4 * (kQuads + q));
    }
  }

  /// block row -= t_0 row_0 + t_1 row_1, from quad kFirst on.
  template <int kFirst>
  void SubtractRow(double t_0, double t_1, double* block_row) const {
#pragma GCC unroll 8
    for (int q = kFirst; q < kQuads; ++q) {
      double* const at = block_row + 4 * q;
      StoreQuad(LoadQuad(at) - t_0 * row_0[q] - t_1 * row_1[q], at);
    }
  }

  /// block -= t_0 row_0^T + t_1 row_1^T, for `num_rows` entries of t = (t_0, t_1).
  void SubtractAll(const double* t, int num_rows, double* block) const {
    for (int i = 0; i < num_rows; ++i) {
      SubtractRow<0>(t[i], t[4 * kQuads + i], block + i * 4 * kQuads);
    }
  }

  /// The same from the diagonal on, rounded down to whole quads.
  template <int kFirst = 0>
  void SubtractUpper(const double* t, int num_rows, double* block) const {
    if constexpr (kFirst < kQuads) {
      for (int i = 4 * kFirst; i < num_rows && i < 4 * kFirst + 4; ++i) {
        SubtractRow<kFirst>(t[i], t[4 * kQuads + i], block + i * 4 * kQuads);
      }
      SubtractUpper<kFirst + 1>(t, num_rows, block);
    }
  }
};

/// t = (row_0 m[0][0] + row_1 m[1][0], row_0 m[0][1] + row_1 m[1][1])
template <int kQuads>
inline void MiddleProduct(const double* rows, const double m[4], double* t) {
  constexpr int kColumns = 4 * kQuads;
  for (int q = 0; q < kQuads; ++q) {
    const Quad row_0 = LoadQuad(rows + 4 * q), row_1 = LoadQuad(rows + kColumns + 4 * q);
    StoreQuad(row_0 * m[0] + row_1 * m[2], t + 4 * q);
    StoreQuad(row_0 * m[1] + row_1 * m[3], t + kColumns + 4 * q);
  }
}

/// What one observation adds to the vectors of its image: J_c^T r, J_c^T (r - Y h), ||J e_j||^2.
template <int kQuads>
inline void UpdateVectors(const double* rows, const double r[2], const double reduced[2],
                          double* vectors) {
  constexpr int kColumns = 4 * kQuads;
  for (int q = 0; q < kQuads; ++q) {
    const Quad row_0 = LoadQuad(rows + 4 * q), row_1 = LoadQuad(rows + kColumns + 4 * q);
    double* at = vectors + 4 * q;
    StoreQuad(LoadQuad(at) + row_0 * r[0] + row_1 * r[1], at);
    at += kColumns;
    StoreQuad(LoadQuad(at) + row_0 * reduced[0] + row_1 * reduced[1], at);
    at += kColumns;
    StoreQuad(LoadQuad(at) + row_0 * row_0 + row_1 * row_1, at);
  }
}

inline double Dot3(const double* a, const double* b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

}  // namespace bundle::fused::BUNDLE_ISA

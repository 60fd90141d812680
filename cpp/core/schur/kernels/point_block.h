#pragma once

/// The 3x3 block of a point, factorised for several points at once. Included by kernels.cpp only.
///
/// With V = sum of J_p^T J_p over the point's observations, g = sum of J_p^T r and the damping
/// (least_squares.h), V' = V + damping D^2 = L L^T. The passes need the lower triangular L^-1 with
/// its columns c0, c1, c2, and h = L^-1 g. Then
///
///   V'^-1 = L^-T L^-1,    y = L^-1 a for a row a^T of J_p,    V'^-1 g = L^-T h.

#include "core/minimize/damping.h"
#include "core/parallel/pack.h"
#include "core/schur/kernels/strip.h"

namespace bundle::BUNDLE_ISA {

/// Sums of one point, and the factor computed from them.
struct PointBlock {
  /// Rows i of V, then entry i of g.
  Quad sum[3];
  double squared_scale[4];  ///< s_j^2; the last unused
  /// Columns of L^-1, then h; last entries are zero.
  Quad column[3];
  Quad h;
  double d_squared[4];  ///< D_j^2; the last unused

  /// y = L^-1 a, the last entry zero.
  Quad Whiten(const Quad& row) const {
    return column[0] * row[0] + column[1] * row[1] + column[2] * row[2];
  }

  double Gradient(int j) const { return sum[j][3]; }

  /// g^T V'^-1 g
  double Decrement() const {
    const Quad squares = h * h;
    return squares[0] + squares[1] + squares[2];
  }
};

/// L^-T y
inline void SolveTransposed(const PointBlock& block, const Quad& y, double* out) {
  for (int j = 0; j < 3; ++j) {
    const Quad product = block.column[j] * y;
    out[j] = product[0] + product[1] + product[2];
  }
}

/// Computes the factors from the sums of `count` points. If `first`, also computes their
/// squared_scale.
inline void Factorize(PointBlock* blocks, int count, double damping, bool first) {
  for (int begin = 0; begin < count; begin += kLanes) {
    double* records[kLanes];
    for (int lane = 0; lane < kLanes; ++lane) {
      const int p = begin + lane < count ? begin + lane : count - 1;
      records[lane] = reinterpret_cast<double*>(blocks + p);
    }
    Pack in[16];
    GatherRecords(records, 16, in);
    Pack scale[4] = {in[12], in[13], in[14], 0.0}, d_squared[4] = {0.0, 0.0, 0.0, 0.0}, v[3];
    for (int j = 0; j < 3; ++j) {
      const Pack squared_norm = in[5 * j];
      if (first) {
        const Pack s = 1 / (1 + Sqrt(squared_norm));
        scale[j] = s * s;
      }
      const Pack scaled = scale[j] * squared_norm;
      const Pack clamped = Select(scaled <= kMinDiagonal, kMinDiagonal,
                                  Select(scaled >= kMaxDiagonal, kMaxDiagonal, scaled));
      d_squared[j] = clamped / scale[j];
      v[j] = squared_norm + damping * d_squared[j];
    }
    // L, with the inverses of its diagonal.
    const Pack i0 = 1 / Sqrt(v[0]);
    const Pack l10 = in[4] * i0, l20 = in[8] * i0;
    const Pack i1 = 1 / Sqrt(v[1] - l10 * l10);
    const Pack l21 = (in[9] - l20 * l10) * i1;
    const Pack i2 = 1 / Sqrt(v[2] - l20 * l20 - l21 * l21);
    const Pack zero = 0.0;
    const Pack i10 = -(l10 * i0 * i1), i21 = -(l21 * i1 * i2);
    const Pack i20 = -((l20 * i0 + l21 * i10) * i2);
    const Pack h0 = i0 * in[3];
    const Pack h1 = i10 * in[3] + i1 * in[7];
    const Pack h2 = i20 * in[3] + i21 * in[7] + i2 * in[11];
    const Pack* const out[6][4] = {{&scale[0], &scale[1], &scale[2], &scale[3]},
                                   {&i0, &i10, &i20, &zero},
                                   {&zero, &i1, &i21, &zero},
                                   {&zero, &zero, &i2, &zero},
                                   {&h0, &h1, &h2, &zero},
                                   {&d_squared[0], &d_squared[1], &d_squared[2], &d_squared[3]}};
    for (int k = 0; k < 6; ++k) ScatterRecords(out[k], records, 12 + 4 * k);
  }
}

/// Sums up the blocks of a strip's points, starting from the contributions of factors, and
/// factorises them. `rows` points at (a_0,
/// r_0, a_1, r_1) of the strip's first observation. Consecutive observations are `stride` doubles
/// apart.
inline void FormPointBlocks(const EliminationInput& input, const Strip& strip, const double* rows,
                            int stride, double damping, bool first, const double* squared_scale,
                            PointBlock* blocks) {
  const int64_t* const begin = input.plan->first.data();
  for (int p = strip.first; p < strip.last; ++p) {
    PointBlock& block = blocks[p - strip.first];
    Quad sum[3] = {};
    if (const double* const prior = input.PriorOf(p)) {
      for (int i = 0; i < 3; ++i) sum[i] = LoadQuad(prior + 4 * i);
    }
    for (int64_t i = begin[p]; i < begin[p + 1]; ++i) {
      const double* const at = rows + (i - strip.begin) * stride;
      for (int row = 0; row < 8; row += 4) {
        const Quad a_r = LoadQuad(at + row);
        for (int j = 0; j < 3; ++j) sum[j] += a_r[j] * a_r;
      }
    }
    for (int i = 0; i < 3; ++i) block.sum[i] = sum[i];
    for (int j = 0; j < 3; ++j) block.squared_scale[j] = first ? 0 : squared_scale[3 * p + j];
    block.squared_scale[3] = 0;
  }
  Factorize(blocks, strip.num_points(), damping, first);
}

inline double Dot3(const double* a, const double* b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

}  // namespace bundle::BUNDLE_ISA

#pragma once

/// Products in 12 x 12 blocks: a pose and a twist (factors/rolling_shutter.h). Included by
/// kernels.cpp only.
///
///   block -= sum of W_a W_b^T over pairs of entries, += sum of A^T M A (tile_products.h)
///
/// in AVX-512 registers. Two panels of six rows would read each factor twice and leave half of
/// every second register empty. Here the last four columns of the first eight rows are summed by
/// rows, and all sums stay in registers: a pair takes 20 multiply-adds of registers per column of W
/// in place of 24. A pair of 6 x 6 blocks takes 6.

#include "core/schur/elimination_plan.h"
#include "core/schur/kernels/kernels.h"
#include "core/schur/kernels/wide_row.h"

namespace bundle::BUNDLE_ISA {

/// Loads what StoreTwelve stores.
template <int kRows>
inline void LoadTwelve(const double* block, WideRow<2>* sum, WideRow<2>* tail, Quad* corner) {
#pragma GCC unroll 12
  for (int r = 0; r < kRows; ++r) sum[r] = WideRow<2>::Load(block + 12 * r);
#pragma GCC unroll 4
  for (int c = 0; c < 4; ++c) {
    tail[c] = LoadColumn(block + 8 + c);
    corner[c] = LoadQuad(block + 12 * (8 + c) + 8);
  }
}

/// Stores the first eight columns of kRows rows of a 12 x 12 block, and the last four: those of the
/// first eight rows are the rows of `tail`, the others `corner`.
template <int kRows>
inline void StoreTwelve(const WideRow<2>* sum, const WideRow<2>* tail, const Quad* corner,
                        double* block) {
#pragma GCC unroll 12
  for (int r = 0; r < kRows; ++r) sum[r].Store(block + 12 * r);
  double columns[4][8];
#pragma GCC unroll 4
  for (int c = 0; c < 4; ++c) {
    tail[c].Store(columns[c]);
    StoreQuad(corner[c], block + 12 * (8 + c) + 8);
  }
  for (int r = 0; r < 8; ++r) {
    double* const to = block + 12 * r + 8;
    StoreQuad(Quad{columns[0][r], columns[1][r], columns[2][r], columns[3][r]}, to);
  }
}

inline void SubtractTwelve(const double* w, int64_t stride, const EntryPair* pairs, int count,
                           double* block) {
  using Row = WideRow<2>;
  Row sum[12], tail[4];
  Quad corner[4];
  LoadTwelve<12>(block, sum, tail, corner);
  for (int i = 0; i < count; ++i) {
    const double* const a = w + stride * pairs[i].first;
    const double* const b = w + stride * pairs[i].second;
#pragma GCC unroll 3
    for (int k = 0; k < 3; ++k) {
      const Row row = Row::Load(b + 12 * k), column = Row::Load(a + 12 * k);
      const Quad rest = LoadQuad(b + 12 * k + 8);
#pragma GCC unroll 12
      for (int r = 0; r < 12; ++r) sum[r].Subtract(a[12 * k + r], row);
#pragma GCC unroll 4
      for (int c = 0; c < 4; ++c) {
        tail[c].Subtract(b[12 * k + 8 + c], column);
        corner[c] -= a[12 * k + 8 + c] * rest;
      }
    }
  }
  StoreTwelve<12>(sum, tail, corner, block);
}

/// block += sum of A^T M A of 12 columns, upper triangle. `Records`: ImageRecords of
/// tile_products.h; the columns begin at `first` doubles from the begin of a record.
template <bool kHasMiddle, typename Records>
void AddTwelve(const Records& records, int first, double* block) {
  using Row = WideRow<2>;
  Row sum[8], tail[4];
  Quad corner[4];
  LoadTwelve<8>(block, sum, tail, corner);
  for (int i = 0; i < records.count; ++i) {
    const double* const record = records.first + records.stride * records.observations[i];
    const double* const a[2] = {record + first, record + first + records.row_stride};
    const Row row[2] = {Row::Load(a[0]), Row::Load(a[1])};
    const Quad end[2] = {LoadQuad(a[0] + 8), LoadQuad(a[1] + 8)};
    Row by[2] = {row[0], row[1]};
    Quad by_end[2] = {end[0], end[1]};
    if constexpr (kHasMiddle) {
      const double* const m = record + 4;
      by[0] = by[1] = {};
#pragma GCC unroll 2
      for (int k = 0; k < 2; ++k) {
        by[k].Add(m[k], row[0]);
        by[k].Add(m[k + 1], row[1]);
        by_end[k] = m[k] * end[0] + m[k + 1] * end[1];
      }
    }
#pragma GCC unroll 2
    for (int k = 0; k < 2; ++k) {
#pragma GCC unroll 8
      for (int r = 0; r < 8; ++r) sum[r].Add(a[k][r], by[k]);
#pragma GCC unroll 4
      for (int c = 0; c < 4; ++c) {
        tail[c].Add(by_end[k][c], row[k]);
        corner[c] += a[k][8 + c] * by_end[k];
      }
    }
  }
  StoreTwelve<8>(sum, tail, corner, block);
}

}  // namespace bundle::BUNDLE_ISA

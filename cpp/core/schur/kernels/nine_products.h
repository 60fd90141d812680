#pragma once

/// Products in 9 x 9 blocks: a pose and three camera parameters. Included by kernels.cpp only.
///
///   block -= sum of W_a W_b^T over pairs of entries, += sum of A^T M A (tile_products.h)
///
/// in AVX-512 registers. Three quads would leave a quarter of the arithmetic to padding; the last
/// column is summed by rows instead.

#include "core/schur/elimination_plan.h"
#include "core/schur/kernels/kernels.h"
#include "core/schur/kernels/wide_row.h"

namespace bundle::BUNDLE_ISA {

/// Stores kRows rows of a 9 x 9 block, and its last column, which was summed as a row.
template <int kRows>
inline void StoreNine(const WideRow<2>* sum, const WideRow<2>& last_column, double last,
                      double* block) {
  double column[8];
  last_column.Store(column);
#pragma GCC unroll 9
  for (int r = 0; r < kRows; ++r) sum[r].Store(block + 12 * r);
  for (int r = 0; r < 8; ++r) block[12 * r + 8] = column[r];
  block[12 * 8 + 8] = last;
}

inline void SubtractNine(const double* w, int64_t stride, const EntryPair* pairs, int count,
                         double* block) {
  using Row = WideRow<2>;
  Row sum[9], last_column = LoadColumn(block + 8);
  double last = block[12 * 8 + 8];
#pragma GCC unroll 9
  for (int r = 0; r < 9; ++r) sum[r] = Row::Load(block + 12 * r);
  for (int i = 0; i < count; ++i) {
    const double* const a = w + stride * pairs[i].first;
    const double* const b = w + stride * pairs[i].second;
#pragma GCC unroll 3
    for (int k = 0; k < 3; ++k) {
      const Row row = Row::Load(b + 12 * k);
#pragma GCC unroll 9
      for (int r = 0; r < 9; ++r) sum[r].Subtract(a[12 * k + r], row);
      last_column.Subtract(b[12 * k + 8], Row::Load(a + 12 * k));
      last -= a[12 * k + 8] * b[12 * k + 8];
    }
  }
  StoreNine<9>(sum, last_column, last, block);
}

/// block += sum of A^T M A of 9 columns, upper triangle. `Records`: ImageRecords of
/// tile_products.h; the columns begin at `first` doubles from the begin of a record.
template <bool kHasMiddle, typename Records>
void AddNine(const Records& records, int first, double* block) {
  using Row = WideRow<2>;
  Row sum[8], last_column = LoadColumn(block + 8);
  double last = block[12 * 8 + 8];
#pragma GCC unroll 8
  for (int r = 0; r < 8; ++r) sum[r] = Row::Load(block + 12 * r);
  for (int i = 0; i < records.count; ++i) {
    const double* const record = records.first + records.stride * records.observations[i];
    const double *a_0 = record + first, *a_1 = a_0 + records.row_stride;
    const Row a[2] = {Row::Load(a_0), Row::Load(a_1)};
    Row b[2] = {a[0], a[1]};
    double end[2] = {a_0[8], a_1[8]};
    if constexpr (kHasMiddle) {
      const double* const m = record + 4;
      b[0] = b[1] = {};
      for (int row = 0; row < 2; ++row) {
        b[row].Add(m[row], a[0]);
        b[row].Add(m[row + 1], a[1]);
        end[row] = m[row] * a_0[8] + m[row + 1] * a_1[8];
      }
    }
#pragma GCC unroll 8
    for (int r = 0; r < 8; ++r) {
      sum[r].Add(a_0[r], b[0]);
      sum[r].Add(a_1[r], b[1]);
    }
    last_column.Add(end[0], a[0]);
    last_column.Add(end[1], a[1]);
    last += end[0] * a_0[8];
    last += end[1] * a_1[8];
  }
  StoreNine<8>(sum, last_column, last, block);
}

}  // namespace bundle::BUNDLE_ISA

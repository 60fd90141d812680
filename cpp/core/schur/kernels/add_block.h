#pragma once

/// Addition of a chunk's block to S, with error terms (sums/double_double.h). Included by
/// kernels.cpp only.

#include "core/parallel/pack.h"
#include "core/schur/kernels/kernels.h"

namespace bundle::BUNDLE_ISA {

/// sum + error += value, number by number, by the six additions of AddDoubleDouble.
template <typename Number>
inline void AddWithError(const Number& value, Number* sum, Number* error) {
  const Number before = *sum, after = before + value;
  const Number added = after - before;
  *error += (before - (after - added)) + (value - added);
  *sum = after;
}

inline void AddBlock(const double* from, int from_stride, int num_rows, int num_columns,
                     const BlockTarget& to) {
  for (int i = 0; i < num_rows; ++i, from += from_stride) {
    double* const sum = to.sum + i * to.sum_stride;
    double* const error = to.error + i * to.error_stride;
    int j = 0;
    for (; j + 4 <= num_columns; j += 4) {
      Quad value = LoadQuad(from + j), total = LoadQuad(sum + j);
      if (to.error == nullptr) {
        total += value;
      } else {
        Quad rest = LoadQuad(error + j);
        AddWithError(value, &total, &rest);
        StoreQuad(rest, error + j);
      }
      StoreQuad(total, sum + j);
    }
    for (; j < num_columns; ++j) {
      if (to.error == nullptr) {
        sum[j] += from[j];
      } else {
        AddWithError(from[j], sum + j, error + j);
      }
    }
  }
}

}  // namespace bundle::BUNDLE_ISA

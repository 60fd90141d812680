#pragma once

/// Maps of the blocks of a chunk (schur/column_map.h). Included by kernels.cpp only.
///
///   M_a^T B M_b,    a.size x b.size,
///
/// of a block B whose rows are a's local columns. A pair of images with hard-tied twists has nine
/// of them, one per pair of poses: more arithmetic than several pairs of observations.

#include "core/schur/column_map.h"
#include "core/schur/kernels/wide_row.h"

namespace bundle::BUNDLE_ISA {

/// For blocks of at most kQuads quads of columns in b. Reads up to four kQuads numbers from the
/// begin of each row of a map, and writes as many at the last row of `out`.
template <int kQuads>
inline void MapRows(const PartBlock& a, const PartBlock& b, const double* block, int width,
                    double* out) {
  using Row = WideRow<kQuads>;
  Row right[kImageColumns];  // B M_b
  for (int i = 0; i < a.num_local; ++i) {
    const double* const row = block + a.local[i] * width;
    if (b.map == nullptr) {
      double selected[4 * kQuads] = {};
      for (int j = 0; j < b.size; ++j) selected[j] = row[b.local[j]];
      right[i] = Row::Load(selected);
      continue;
    }
    Row sum = {};
    for (int k = 0; k < b.num_local; ++k) {
      sum.Add(row[b.local[k]], Row::Load(b.map + k * b.size));
    }
    right[i] = sum;
  }
  for (int u = 0; u < a.size; ++u) {
    Row sum = {};
    if (a.map == nullptr) sum = right[u];
    for (int k = 0; k < a.num_local && a.map != nullptr; ++k) {
      sum.Add(a.map[k * a.size + u], right[k]);
    }
    sum.Store(out + u * b.size);
  }
}

inline void MapBlock(const PartBlock& a, const PartBlock& b, const double* block, int width,
                     double* out) {
  if (b.size <= 8) {
    MapRows<2>(a, b, block, width, out);
  } else {
    MapRows<(kImageColumns + 3) / 4>(a, b, block, width, out);
  }
}

}  // namespace bundle::BUNDLE_ISA

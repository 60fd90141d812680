#pragma once

/// Sums into a symmetric matrix with the structure of S, of which one of two symmetric blocks is
/// stored.

#include <cstddef>
#include <cstdint>

#include "core/covariance/point_blocks.h"
#include "core/linear/block_structure.h"

namespace bundle {

class SymmetricSum {
 public:
  /// Keeps both.
  SymmetricSum(const BlockStructure& structure, BlockValues* values)
      : structure_(structure), values_(*values) {}

  /// block(r, c) += value(r, c), for the block on or below the diagonal.
  template <typename Value>
  void Add(int row, int column, const Value& value) {
    const int64_t entry = structure_.Entry(column, row);
    for (int c = 0; c < structure_.block_size(column); ++c) {
      for (int r = 0; r < structure_.block_size(row); ++r) {
        values_[structure_.ValueIndex(column, entry, r, c)] += value(r, c);
      }
    }
  }

  /// of_rows J_i^T J_i + of_scores G_i G_i^T
  void AddOwn(const ObservationRows& rows, double of_rows, double of_scores) {
    double shares[ObservationRows::kMaxBlocks][BlockSystem::kMaxBlockSize];
    for (int b = 0; b < rows.num_blocks; ++b) ShareOf(rows, b, shares[b]);
    for (int a = 0; a < rows.num_blocks; ++a) {
      for (int b = 0; b < rows.num_blocks; ++b) {
        if (rows.block[a] < rows.block[b]) continue;
        Add(rows.block[a], rows.block[b], [&](int r, int c) {
          const double *const x = rows.jacobian[a] + r, *const y = rows.jacobian[b] + c;
          return of_rows * (x[0] * y[0] + x[rows.size[a]] * y[rows.size[b]]) +
                 of_scores * shares[a][r] * shares[b][c];
        });
      }
    }
  }

  /// -Y W^T
  void SubtractEliminated(const PointBlocks& blocks) {
    for (size_t a = 0; a < blocks.blocks.size(); ++a) {
      for (size_t b = 0; b <= a; ++b) {
        Add(blocks.blocks[a], blocks.blocks[b], [&](int r, int c) {
          const double* const y = &blocks.y[3 * size_t(blocks.begin[a] + r)];
          const double* const w = &blocks.w[3 * size_t(blocks.begin[b] + c)];
          return -(y[0] * w[0] + y[1] * w[1] + y[2] * w[2]);
        });
      }
    }
  }

 private:
  const BlockStructure& structure_;
  BlockValues& values_;
};

}  // namespace bundle

#pragma once

#include <cstdint>
#include <vector>

#include "core/fused/reduced/reduced_system.h"

namespace bundle::fused {

/// The inverse of a block-diagonal matrix with the blocks of a reduced system.
class BlockDiagonalInverse {
 public:
  /// Keeps a reference to the structure.
  explicit BlockDiagonalInverse(const ReducedStructure& structure);

  /// Inverts a block given by its lower triangle, column-major, `stride` from column to column.
  /// False if it is not positive definite.
  bool Invert(int block, const double* values, int stride);

  /// Inverts the diagonal blocks of S. False if one of them is not positive definite.
  bool InvertDiagonal(const std::vector<double>& values);

  /// y = inverse x
  void Multiply(const double* x, double* y) const;

  /// Where a block's values begin among those of all blocks, one after the other.
  int64_t begin(int block) const { return begin_[block]; }

 private:
  const ReducedStructure& structure_;
  std::vector<int64_t> begin_;  ///< num_blocks + 1
  std::vector<double> values_;  ///< column-major squares
};

}  // namespace bundle::fused

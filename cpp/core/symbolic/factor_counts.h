#pragma once

/// Symbolic factorisation: fill-in, nnz(L) and flops of a Cholesky factor (derived in
/// factor_counts.cpp).

#include <cstdint>
#include <vector>

#include "core/symbolic/block_pattern.h"

namespace bundle {

/// Exact cost of the Cholesky factor L of a matrix for one order of its blocks. All vectors are by
/// position in the order, not by block.
///
/// Eliminating a scalar column with c entries below its diagonal changes the c (c + 1) / 2 entries
/// of a lower triangle and c entries of the right-hand side, each by a multiplication and a
/// subtraction: c^2 + 3 c flops. CHOLMOD counts (c + 1)^2, which excludes the right-hand side and
/// includes the divisions and the square root.
struct FactorCounts {
  double entries = 0;         ///< nnz(L): lower triangle with the diagonal
  double flops = 0;           ///< sum of c^2 + 3 c
  double cholmod_flops = 0;   ///< sum of (c + 1)^2, cholmod_common::fl
  int64_t block_entries = 0;  ///< blocks of L, the diagonal's included
  int64_t fill_edges =
      0;                ///< number of fill-in blocks: block_entries minus the blocks of the matrix
  int tree_height = 0;  ///< blocks on the longest path from a leaf to a root; 0 without blocks
  std::vector<int> parent;  ///< in the elimination tree, -1 for a root
  std::vector<int>
      postorder;  ///< positions; children first, the one with most rows next to its parent
  std::vector<int64_t> rows_below;    ///< scalar rows below each diagonal block of L
  std::vector<int64_t> blocks_below;  ///< block rows below it
};

/// `order` is a permutation of the blocks (CheckOrder); `pattern` must be valid.
FactorCounts CountFactor(const BlockPatternView& pattern, const std::vector<int>& order);

/// `entries` and `flops` of a dense matrix of n columns.
double DenseFactorEntries(double n);
double DenseFactorFlops(double n);

}  // namespace bundle

#pragma once

/// The reduced camera system S x = b: the normal equations after the elimination of the points
/// (schur/).
///
/// S is symmetric positive definite. It has one block row and one block column per block of the
/// parameter layout. Its lower triangle is stored by block columns. Each block column is a panel of
/// column-major values, as tall as its blocks. So a dense S is a matrix for LAPACK, and a sparse S
/// has the value array of a compressed-column matrix. Neither is copied before the factorisation.
/// Diagonal blocks have storage for both triangles; only their lower triangle is defined. A panel
/// may have more rows than its blocks, as the solver of a sparse S requires, and may be stored
/// between other panels (supernodal_cholesky.h).

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "core/scratch/page_arena.h"

namespace bundle {

/// Blocks of S that may be nonzero, and their places in memory.
struct BlockStructure {
  std::vector<int> offset;            ///< num_blocks + 1: first row and column of a block
  std::vector<int64_t> column_begin;  ///< num_blocks + 1: first entry of a block column
  std::vector<int> row_block;         ///< block row of each entry; ascending, the diagonal first
  std::vector<int> row_in_panel;      ///< first row of each entry's block within its panel
  std::vector<int64_t> panel_begin;   ///< num_blocks: begin of a block column's values
  std::vector<int> panel_stride;      ///< num_blocks: distance of consecutive columns of a panel
  int64_t num_values = 0;
  bool dense = false;  ///< one n x n column-major matrix

  int num_blocks() const { return static_cast<int>(panel_begin.size()); }
  int num_columns() const { return offset.back(); }
  int block_size(int block) const { return offset[block + 1] - offset[block]; }

  /// The entry of block (row, column), on or below the diagonal; it must be in the structure.
  int64_t Entry(int column, int row) const {
    const int64_t begin = column_begin[column];
    if (dense || row == column) return begin + (row - column);
    const auto first = row_block.begin() + begin;
    const auto last = row_block.begin() + column_begin[column + 1];
    return std::lower_bound(first, last, row) - row_block.begin();
  }

  /// The block that contains row or column `j` of the matrix.
  int BlockOf(int j) const {
    return static_cast<int>(std::upper_bound(offset.begin(), offset.end(), j) - offset.begin()) - 1;
  }

  /// Offset of entry (r, c) of block e in block column j.
  int64_t ValueIndex(int j, int64_t e, int r, int c) const {
    return panel_begin[j] + static_cast<int64_t>(c) * panel_stride[j] + row_in_panel[e] + r;
  }

  /// Calls visit(j, index of its value) for the entries (j, j) of the matrix, in order.
  template <typename Visit>
  void ForDiagonal(const Visit& visit) const {
    for (int b = 0; b < num_blocks(); ++b) {
      for (int k = 0; k < block_size(b); ++k) {
        visit(offset[b] + k, ValueIndex(b, column_begin[b], k, k));
      }
    }
  }
};

/// Begins of the diagonal blocks when they are stored one after the other, then the end.
std::vector<int64_t> DiagonalBlockOffsets(const BlockStructure& structure);

/// Structure with all blocks nonzero. `block_sizes` in the order of the layout.
BlockStructure DenseStructure(const std::vector<int>& block_sizes);

/// `columns[j]`: the block rows i >= j of block column j, ascending, starting with j.
BlockStructure SparseStructure(const std::vector<int>& block_sizes,
                               const std::vector<std::vector<int>>& columns);

/// Structure of a graph with blocks of equal size: one per node, and one per pair of nodes that an
/// edge joins. `pairs`: two different nodes each, in any order; duplicates count once.
BlockStructure StructureOfPairs(int num_nodes, int block_size,
                                const std::vector<std::pair<int, int>>& pairs);

/// Sparse structure with the blocks in another order: block order[k] becomes block k.
BlockStructure Reorder(const BlockStructure& structure, const std::vector<int>& order);

/// Structure with the same blocks in the same order, without room for fill-in between them: a panel
/// per block column, as tall as its blocks. For copies of S that are stored, summed or sent.
BlockStructure CompactStructure(const BlockStructure& structure);

/// Adds the values of all blocks of `from` to the same blocks of `to`, which may have further
/// blocks. The sizes and the order of blocks are the same in both.
///
/// Throws std::logic_error if `to` lacks a block.
void AddBlocks(const BlockStructure& from, const double* values, const BlockStructure& to,
               double* sums);

/// Values in the layout of a BlockStructure.
using BlockValues = ArenaVector<double>;

/// Block (row, column) of a symmetric matrix whose lower triangle is stored; row-major. The block
/// must be in the structure.
void CopyBlock(const BlockStructure& structure, const BlockValues& values, int row, int column,
               double* out);

struct BlockSystem {
  BlockValues values;       ///< S in the layout of the structure; zero outside of its blocks
  std::vector<double> rhs;  ///< b
  /// Block diagonal of the camera parameters' part of the normal equations before the elimination,
  /// J_c^T J_c plus damping. Each block is square and column-major, one after the other. Empty
  /// unless a preconditioner needs it.
  std::vector<double> camera_diagonal;
  /// For each column of S, the derivatives of its unknown w.r.t. the seven similarities of the
  /// world (model/gauge.h). Empty unless a preconditioner needs them.
  std::vector<double> gauge_directions;

  /// Both constants equal those of the model's parameters (asserted in schur/schur_setup.cpp).
  static constexpr int kNumGaugeDirections = 7;
  static constexpr int kMaxBlockSize = 28;
};

}  // namespace bundle

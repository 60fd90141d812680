#pragma once

/// The reduced camera system S x = b: the normal equations after the elimination of the points
/// (schur/).
///
/// S is symmetric positive definite with one block row and column a block of the parameter layout.
/// Its lower triangle is stored by block columns. Each is a panel of column-major values as tall as
/// the blocks in it, so that a dense S is the matrix LAPACK takes and a sparse one has the value
/// array of a compressed-column matrix, and neither is copied before it is factorised. Diagonal
/// blocks are stored whole; only their lower triangle is defined. A panel may have more rows than
/// its blocks, and be stored among others, as the solver of a sparse S needs it
/// (supernodal_cholesky.h).

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace bundle {

/// Blocks of S that may be nonzero, and where they are stored.
struct BlockStructure {
  std::vector<int> offset;            ///< num_blocks + 1: first row and column of a block
  std::vector<int64_t> column_begin;  ///< num_blocks + 1: first entry of a block column
  std::vector<int> row_block;         ///< block row of each entry; ascending, the diagonal first
  std::vector<int> row_in_panel;      ///< first row of each entry's block within its panel
  std::vector<int64_t> panel_begin;   ///< num_blocks: where a block column's values begin
  std::vector<int> panel_stride;      ///< num_blocks: from one column of a panel to the next
  int64_t num_values = 0;
  bool dense = false;  ///< one n x n column-major matrix

  int num_blocks() const { return static_cast<int>(panel_begin.size()); }
  int num_columns() const { return offset.back(); }
  int block_size(int block) const { return offset[block + 1] - offset[block]; }

  /// The entry of block (row, column) on or below the diagonal, which is one of those that may be
  /// nonzero.
  int64_t Entry(int column, int row) const {
    const int64_t begin = column_begin[column];
    if (dense) return begin + (row - column);
    const auto first = row_block.begin() + begin;
    const auto last = row_block.begin() + column_begin[column + 1];
    return std::lower_bound(first, last, row) - row_block.begin();
  }

  /// The block that has row or column `j` of the matrix.
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

/// Begins of the diagonal blocks when they are stored one after the other, and the end.
std::vector<int64_t> DiagonalBlockOffsets(const BlockStructure& structure);

/// Every block nonzero. `block_sizes` in the order of the layout.
BlockStructure DenseStructure(const std::vector<int>& block_sizes);

/// `columns[j]`: the block rows i >= j of block column j, ascending, j itself first.
BlockStructure SparseStructure(const std::vector<int>& block_sizes,
                               const std::vector<std::vector<int>>& columns);

/// A graph's blocks, all of one size: those of the nodes and of the pairs that an edge joins.
/// `pairs` two different nodes each, in any order; of several equal ones one counts.
BlockStructure StructureOfPairs(int num_nodes, int block_size,
                                const std::vector<std::pair<int, int>>& pairs);

/// A sparse structure with the blocks in another order: order[k] becomes the k-th.
BlockStructure Reorder(const BlockStructure& structure, const std::vector<int>& order);

/// The same blocks in the same order without room for fill-in between them: a panel per block
/// column, as tall as its blocks. For copies of S that are kept, summed or sent.
BlockStructure CompactStructure(const BlockStructure& structure);

/// Adds the values of all blocks of `from` to the same blocks of `to`, which may have further
/// blocks. The sizes and the order of blocks are the same in both.
///
/// Throws std::logic_error where `to` lacks a block.
void AddBlocks(const BlockStructure& from, const double* values, const BlockStructure& to,
               double* sums);

/// Block (row, column) of a symmetric matrix of which the lower triangle is stored, row-major; only
/// for blocks of the structure.
void CopyBlock(const BlockStructure& structure, const std::vector<double>& values, int row,
               int column, double* out);

struct BlockSystem {
  std::vector<double> values;  ///< S, as the structure says; zero where it has no block
  std::vector<double> rhs;     ///< b
  /// The camera parameters' part of the normal equations before anything is eliminated, J_c^T J_c
  /// plus damping: its block diagonal, each block square and column-major, one after the other.
  /// Empty unless a preconditioner asks for it.
  std::vector<double> camera_diagonal;
  /// For each column of S, the derivatives of its unknown by the seven similarities of the world
  /// (model/gauge.h). Empty unless a preconditioner asks for it.
  std::vector<double> gauge_directions;

  /// Both are those of the model's parameters (asserted in schur/schur_setup.cpp).
  static constexpr int kNumGaugeDirections = 7;
  static constexpr int kMaxBlockSize = 22;
};

/// Asks the system for large pages where nothing has been touched yet. No more than a hint.
void AdviseHugePages(void* begin, size_t num_bytes);

/// Reserves `size` values and asks the system for large pages before they are touched. Sums into a
/// large S access it everywhere, and with pages of 4 kB nearly each of its columns is also a miss
/// of the address translation. Without large pages, only a reserve.
template <typename T>
void ReserveHugePages(size_t size, std::vector<T>* values) {
  if (size <= values->capacity()) return;
  values->reserve(size);
  AdviseHugePages(values->data(), size * sizeof(T));
}

}  // namespace bundle

#pragma once

/// Patterns of symmetric block matrices.
///
/// A pattern lists the blocks that may be nonzero. It is a graph with a vertex per block row and
/// column, and an edge per nonzero block off the diagonal. Only the lower triangle is stored, by
/// block columns.

#include <cstdint>
#include <vector>

namespace bundle {

/// View of a pattern in the caller's arrays.
struct BlockPatternView {
  int num_blocks = 0;
  const int* size = nullptr;  ///< num_blocks: rows and columns of a diagonal block, >= 1
  const int64_t* column_begin = nullptr;  ///< num_blocks + 1: first entry of a block column
  const int* row = nullptr;               ///< block rows; ascending in a column, the diagonal first

  int64_t num_entries() const { return num_blocks == 0 ? 0 : column_begin[num_blocks]; }
  /// Edges of the graph: entries below the diagonal.
  int64_t num_edges() const { return num_entries() - num_blocks; }
};

struct BlockPattern {
  std::vector<int> size;
  std::vector<int64_t> column_begin{0};
  std::vector<int> row;

  operator BlockPatternView() const {  // NOLINT: a view of it is what every function takes
    return {static_cast<int>(size.size()), size.data(), column_begin.data(), row.data()};
  }
};

/// `columns[j]`: the block rows i >= j of block column j, ascending, starting with j.
BlockPattern MakeBlockPattern(std::vector<int> size, const std::vector<std::vector<int>>& columns);

/// Throws InputError, naming the block, if the pattern does not have the form above.
void CheckBlockPattern(const BlockPatternView& pattern);

/// A lower triangle by block rows, diagonal included; entries of a row are not sorted.
struct BlockRows {
  std::vector<int64_t> begin;
  std::vector<int> column;
};

/// Rows of the permuted matrix, with block `blocks[k]` at position k.
BlockRows PermuteRows(const BlockPatternView& pattern, const std::vector<int>& blocks);

BlockPattern PatternOfRows(const BlockRows& rows, std::vector<int> size);

/// Rows and columns of the matrix.
int64_t NumColumns(const BlockPatternView& pattern);

/// Nonzeros of the matrix with full blocks: both triangles and the diagonal.
double NumNonzeros(const BlockPatternView& pattern);

}  // namespace bundle

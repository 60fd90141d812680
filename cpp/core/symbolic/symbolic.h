#pragma once

/// Symbolic factorisation of symmetric block matrices: patterns, elimination orders, and the cost
/// of the factor.
///
/// A pattern says which blocks may be nonzero. It is a graph: a vertex per block row and column, an
/// edge per pair of blocks that meet. Only the lower triangle is kept, by block columns. An order
/// holds at k the block that is eliminated as the k-th.

#include <cholmod.h>

#include <cstdint>
#include <string>
#include <vector>

namespace bundle {

/// A pattern in arrays of the caller.
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

/// `columns[j]`: the block rows i >= j of block column j, ascending, j itself first.
BlockPattern MakeBlockPattern(std::vector<int> size, const std::vector<std::vector<int>>& columns);

/// Throws InputError, naming the block, if the pattern is not of the form above.
void CheckBlockPattern(const BlockPatternView& pattern);

/// A lower triangle by block rows, the diagonal included; in no order within a row.
struct BlockRows {
  std::vector<int64_t> begin;
  std::vector<int> column;
};

/// Of the same matrix with block `blocks[k]` as its k-th.
BlockRows PermuteRows(const BlockPatternView& pattern, const std::vector<int>& blocks);

BlockPattern PatternOfRows(const BlockRows& rows, std::vector<int> size);

/// Rows and columns of the matrix.
int64_t NumColumns(const BlockPatternView& pattern);

/// Nonzeros of the matrix, its blocks full: both triangles and the diagonal.
double NumNonzeros(const BlockPatternView& pattern);

/// CHOLMOD's workspace and settings for its orderings, silent: errors are in
/// `common.status`. Its 64-bit functions throughout, as a matrix may have more than 2^31 values.
class CholmodSession {
 public:
  CholmodSession() {
    cholmod_l_start(&common);
    common.print = 0;
    common.try_catch = 1;
    common.error_handler = nullptr;
    // The default moves rows of more than 10 sqrt(n) entries to the end, unordered. In the graph of
    // a photo collection these are most of its rows.
    common.method[0].prune_dense = -1;
  }
  ~CholmodSession() { cholmod_l_finish(&common); }
  CholmodSession(const CholmodSession&) = delete;
  CholmodSession& operator=(const CholmodSession&) = delete;

  cholmod_common common;
};

/// How an order of elimination is found, on the graph of the blocks.
enum class OrderingMethod { kNatural, kReverse, kAmd, kColamd, kMetis, kNesdis };

/// Throws InputError if there is no method of that name.
OrderingMethod OrderingFromName(const std::string& name);

/// "natural", "reverse", "amd", "colamd", "metis", "nesdis"
std::string OrderingName(OrderingMethod method);

/// METIS and NESDIS look for small separators, of which a nearly full graph has none; they return
/// AMD's order for one, as CHOLMOD does.
///
/// COLAMD orders the columns of a matrix A such that A^T A stays sparse. It is given an A for which
/// A^T A has the pattern at hand: a row for each edge, with an entry in either vertex' column.
///
/// Empty if the method failed, which only a lack of memory makes it do.
std::vector<int> FindOrder(const BlockPatternView& pattern, OrderingMethod method);

/// True for a graph that METIS and NESDIS are kept from.
bool IsNearlyFull(const BlockPatternView& pattern);

/// Throws InputError unless `order` holds each of 0 ... num_blocks - 1 once.
void CheckOrder(const std::vector<int>& order, int num_blocks);

/// What the Cholesky factor L of a matrix costs under one order of its blocks, exactly and without
/// arithmetic. All vectors are by position in the order, not by block.
///
/// Eliminating a scalar column with c entries below its diagonal changes the c (c + 1) / 2 entries
/// of a lower triangle and c of the right hand side, each by a multiplication and a subtraction:
/// c^2 + 3 c flops. CHOLMOD counts (c + 1)^2, which leaves the right hand side out and lets the
/// divisions and the square root in.
struct FactorCounts {
  double entries = 0;         ///< of L: its lower triangle with the diagonal
  double flops = 0;           ///< sum of c^2 + 3 c
  double cholmod_flops = 0;   ///< sum of (c + 1)^2, cholmod_common::fl
  int64_t block_entries = 0;  ///< blocks of L, the diagonal's included
  int64_t fill_edges = 0;     ///< block_entries without the blocks that the matrix has there
  int tree_height = 0;      ///< blocks on the longest path from a leaf to a root; 0 without blocks
  std::vector<int> parent;  ///< in the elimination tree, -1 for a root
  std::vector<int>
      postorder;  ///< positions; children first, the one with most rows next to its parent
  std::vector<int64_t> rows_below;    ///< scalar rows below each diagonal block of L
  std::vector<int64_t> blocks_below;  ///< block rows below it
};

/// `order` is a permutation of the blocks (CheckOrder), `pattern` of the right form.
FactorCounts CountFactor(const BlockPatternView& pattern, const std::vector<int>& order);

/// `entries` and `flops` of a matrix of n columns that has no zeros.
double DenseFactorEntries(double n);
double DenseFactorFlops(double n);

}  // namespace bundle

#pragma once

/// Coarse space of the two-level preconditioner (derived in coarse_space.cpp).

#include <cstdint>
#include <memory>
#include <vector>

#include "core/linear/block_structure.h"
#include "core/linear/supernodal_cholesky.h"

namespace bundle {

/// Some directions for each cluster of blocks, the columns of Q, and the coarse system A = Q^T S Q.
class CoarseSpace {
 public:
  static constexpr int kNumGaugeDirections = BlockSystem::kNumGaugeDirections;

  /// Forms clusters from the first system. Keeps a reference to the structure.
  CoarseSpace(const BlockStructure& structure, const BlockSystem& system, int num_threads);

  int num_columns() const { return coarse_.num_columns(); }

  /// Computes Q, A and the factor of A for a system. False if A is not positive definite.
  bool Factorize(const BlockSystem& system);

  /// x = A^-1 x
  void Solve(double* x);

  /// to = Q^T from, and to += Q from.
  void Restrict(const double* from, double* to) const;
  void AddProlonged(const double* from, double* to) const;

 private:
  /// A block of S whose rows and columns belong to a block of A.
  struct Term {
    int64_t value;  ///< index of the block's first value
    int stride;     ///< distance of its consecutive columns
    int row_block;  ///< coarse block row
    int col_block;
    bool transposed;  ///< S stores the transpose of this block
    bool diagonal;    ///< only its lower triangle is defined
  };

  void NumberClusters(const std::vector<int>& cluster);
  void CollectTerms();
  void MakeDirections(const BlockSystem& system, int cluster);
  void ProjectEntry(const BlockValues& values, int column, int64_t entry);
  int num_directions(int block) const { return coarse_.block_size(cluster_[block]); }

  const BlockStructure& fine_;
  const int num_threads_;
  std::vector<char> moves_;   ///< per column of S: 1 if a similarity changes its unknown
  std::vector<int> cluster_;  ///< cluster per block of S
  std::vector<std::vector<int>> members_;  ///< the blocks of each cluster, ascending
  BlockStructure coarse_;  ///< structure of A: one block per cluster, at its place in the factor
  std::unique_ptr<SupernodalCholesky> cholesky_;
  std::vector<int> coarse_column_;   ///< per coarse entry
  std::vector<int64_t> term_begin_;  ///< per coarse entry
  std::vector<Term> input_;
  std::vector<int64_t> direction_begin_;  ///< per block of S: its begin in directions_
  std::vector<double> directions_;        ///< Q: the rows of each block, one after the other
  std::vector<char> is_idle_;             ///< per column of Q: 1 if it is zero
  std::vector<double> values_;            ///< values of A
};

}  // namespace bundle

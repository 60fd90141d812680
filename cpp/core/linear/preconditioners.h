#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <vector>

#include "core/interface/options.h"
#include "core/linear/block_structure.h"
#include "core/linear/supernodal_cholesky.h"

namespace bundle {

/// z = M^-1 r, with M near S and easier to invert.
class Preconditioner {
 public:
  virtual ~Preconditioner() = default;

  /// Prepares for a system. False if M is not positive definite.
  virtual bool Update(const BlockSystem& system, const std::vector<double>& scale) = 0;

  virtual void Multiply(const double* r, double* z) = 0;

  /// As LinearSolver::ForgetValues.
  virtual void ForgetValues() {}

  virtual bool NeedsCameraDiagonal() const { return false; }
  virtual bool NeedsGaugeDirections() const { return false; }
  /// Of the forcing term that conjugate gradients stop by.
  virtual double ForcingFactor() const { return 1; }
};

/// `preconditioner` is one of kIdentity, kJacobi, kSchurJacobi, kSchurPowerSeriesExpansion and
/// kTwoLevel.
/// Keeps references to the structure and the product.
std::unique_ptr<Preconditioner> MakePreconditioner(PreconditionerType preconditioner,
                                                   const BlockStructure& structure,
                                                   SymmetricProduct* product, int num_threads);

/// The inverse of a block-diagonal matrix with the blocks of a reduced system.
class BlockDiagonalInverse {
 public:
  /// Keeps a reference to the structure.
  explicit BlockDiagonalInverse(const BlockStructure& structure);

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
  const BlockStructure& structure_;
  std::vector<int64_t> begin_;  ///< num_blocks + 1
  std::vector<double> values_;  ///< column-major squares
};

/// Schur-Jacobi and a correction on a coarse space. Keeps a reference to the structure.
std::unique_ptr<Preconditioner> MakeTwoLevelPreconditioner(const BlockStructure& structure,
                                                           int num_threads);

/// Groups of strongly coupled blocks, of at most `max_size` each: the cluster of every block, from
/// 0 on. Blocks marked in `alone` are clusters of their own. `values` are those of S.
std::vector<int> ClusterBlocks(const BlockStructure& structure, const std::vector<double>& values,
                               const std::vector<char>& alone, int max_size);

/// Columns of Q (coarse_space.cpp) on the rows of a cluster's blocks, one block after the other.
struct ClusterDirections {
  Eigen::MatrixXd q;
  std::vector<char> is_idle;  ///< of each column: it depends on those before it, and is zero
};

/// Whether a similarity changes any unknown of a block. `moves`: of each column of S, that one
/// does.
bool MovesBlock(const BlockStructure& structure, const std::vector<char>& moves, int block);

/// The gauge directions, if the cluster has blocks that they move, and the k-th intrinsics of all
/// of its blocks, for each k: `num_columns` in all. `blocks`: those of the cluster.
ClusterDirections FindClusterDirections(const BlockStructure& structure, const BlockSystem& system,
                                        const std::vector<char>& moves,
                                        const std::vector<int>& blocks, int num_columns);

/// A few directions for each cluster of blocks, the columns of Q, and S on them: A = Q^T S Q.
class CoarseSpace {
 public:
  static constexpr int kNumGaugeDirections = BlockSystem::kNumGaugeDirections;

  /// Forms clusters from the first system. Keeps a reference to the structure.
  CoarseSpace(const BlockStructure& structure, const BlockSystem& system, int num_threads);

  int num_columns() const { return coarse_.num_columns(); }

  /// Makes Q and A for a system, and the factor of A. False if A is not positive definite.
  bool Factorize(const BlockSystem& system);

  /// x = A^-1 x
  void Solve(double* x);

  /// to = Q^T from, and to += Q from.
  void Restrict(const double* from, double* to) const;
  void AddProlonged(const double* from, double* to) const;

 private:
  /// A block of S whose rows and columns belong to a block of A.
  struct Term {
    int64_t value;  ///< where the block's first value is
    int stride;     ///< from one of its columns to the next
    int row_block;  ///< of the coarse block's rows, thus transposed if ...
    int col_block;
    bool transposed;  ///< ... S stores the block the other way around
    bool diagonal;    ///< only its lower triangle means anything
  };

  void NumberClusters(const std::vector<int>& cluster);
  void CollectTerms();
  void MakeDirections(const BlockSystem& system, int cluster);
  void ProjectEntry(const std::vector<double>& values, int column, int64_t entry);
  int num_directions(int block) const { return coarse_.block_size(cluster_[block]); }

  const BlockStructure& fine_;
  const int num_threads_;
  std::vector<char> moves_;                ///< of each column of S: a similarity changes it
  std::vector<int> cluster_;               ///< of each block of S
  std::vector<std::vector<int>> members_;  ///< the blocks of each cluster, ascending
  BlockStructure coarse_;                  ///< of A: a block a cluster, placed in its factor
  std::unique_ptr<SupernodalCholesky> cholesky_;
  std::vector<int> coarse_column_;   ///< of each coarse entry
  std::vector<int64_t> term_begin_;  ///< of each coarse entry
  std::vector<Term> input_;
  std::vector<int64_t> direction_begin_;  ///< of each block of S in directions_
  std::vector<double> directions_;        ///< Q: a block's rows, one after the other
  std::vector<char> is_idle_;             ///< of each column of Q: it is zero
  std::vector<double> values_;            ///< of A
};

}  // namespace bundle

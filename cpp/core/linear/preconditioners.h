#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "core/interface/options.h"
#include "core/linear/block_structure.h"
#include "core/linear/symmetric_product.h"

namespace bundle {

/// Preconditioner of conjugate gradients: z = M^-1 r, where M approximates S and is easier to
/// invert.
class Preconditioner {
 public:
  virtual ~Preconditioner() = default;

  /// Prepares for a system. False if M is not positive definite.
  virtual bool Update(const BlockSystem& system, const std::vector<double>& scale) = 0;

  virtual void Multiply(const double* r, double* z) = 0;

  /// Same as LinearSolver::ForgetValues.
  virtual void ForgetValues() {}

  virtual bool NeedsCameraDiagonal() const { return false; }
  virtual bool NeedsGaugeDirections() const { return false; }
  /// Factor on the forcing term by which conjugate gradients stop.
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
  bool InvertDiagonal(const BlockValues& values);

  /// y = inverse x
  void Multiply(const double* x, double* y) const;

  /// Begin of a block's values among the values of all blocks.
  int64_t begin(int block) const { return begin_[block]; }

 private:
  const BlockStructure& structure_;
  std::vector<int64_t> begin_;  ///< num_blocks + 1
  std::vector<double> values_;  ///< column-major squares
};

/// Schur-Jacobi and a correction on a coarse space. Keeps a reference to the structure.
std::unique_ptr<Preconditioner> MakeTwoLevelPreconditioner(const BlockStructure& structure,
                                                           int num_threads);

}  // namespace bundle

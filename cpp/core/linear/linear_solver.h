#pragma once

/// Linear solvers of the reduced camera system: their interface, solutions and statistics.

#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include "core/interface/linear_status.h"
#include "core/linear/block_structure.h"

namespace bundle {

struct LinearSolution {
  LinearStatus status = LinearStatus::kSuccess;
  int num_iterations =
      1;  ///< iterations of conjugate gradients; 1 for a factorisation, as in Ceres
  std::string message;
  int failed_minor = 0;  ///< order of the leading minor that is not positive definite; 0: unknown
};

/// Cost of a factorisation, for reports.
struct FactorStatistics {
  std::string ordering;  ///< FillOrdering::name; empty without a factorisation
  double entries = 0;    ///< nnz(L) without the zeros that supernodes add
  double flops = 0;      ///< FactorCounts::flops
  double predicted = 0;  ///< predicted `entries` of the chosen ordering
  double stored = 0;  ///< entries including these zeros; only the lower triangle of diagonal blocks
};

/// Solves reduced camera systems of one structure, one after the other. Call Factorize once per
/// system, then Solve with any number of right-hand sides, any number of times.
class LinearSolver {
 public:
  virtual ~LinearSolver() = default;

  /// Factorises S; conjugate gradients prepare their preconditioner. Reads and may overwrite the
  /// values, which must not change until the last Solve. `scale` is the Jacobi scaling of the
  /// columns: an iterative solver iterates on x / scale, as in Ceres. After a failure or an
  /// exception, Solve is not allowed until Factorize succeeds.
  LinearSolution Factorize(BlockSystem* system, const std::vector<double>& scale) {
    is_factorized_ = false;
    LinearSolution result = DoFactorize(system, scale);
    is_factorized_ = result.status == LinearStatus::kSuccess;
    return result;
  }

  /// X = S^-1 B, both num_columns x num_rhs, column-major, and not the same array. `eta` is the
  /// forcing term of an iterative solver, which counts the iterations of all right-hand sides;
  /// direct solvers ignore it. Stops at the first right-hand side that fails; X is then undefined.
  ///
  /// Throws std::logic_error without a successful Factorize.
  LinearSolution Solve(const double* rhs, int num_rhs, double eta, double* x) {
    if (!is_factorized_)
      throw std::logic_error("Solve: expected a Factorize that succeeded before");
    return DoSolve(rhs, num_rhs, eta, x);
  }

  /// Factorizes, and solves for the right-hand side of the system, for a step.
  LinearSolution Solve(BlockSystem* system, const std::vector<double>& scale, double eta,
                       double* x) {
    LinearSolution factorized = Factorize(system, scale);
    if (factorized.status != LinearStatus::kSuccess) return factorized;
    return Solve(system->rhs.data(), 1, eta, x);
  }

  /// Replaces the factor by the blocks of S^-1 at the blocks of S; of diagonal blocks only the
  /// lower triangle is valid. Solve is not allowed afterwards.
  ///
  /// Throws std::logic_error without a successful Factorize, and for iterative solvers.
  LinearSolution InvertBlocks() {
    if (!is_factorized_) throw std::logic_error("InvertBlocks: expected a Factorize before");
    is_factorized_ = false;
    return DoInvertBlocks();
  }

  /// Allows Solve again after InvertBlocks. The caller has put the factor back into the values.
  void RestoreFactor() { is_factorized_ = true; }

  /// Removes all data that depend on values of earlier systems (clusters of blocks, for instance),
  /// so that it solves like a new solver. Keeps data that follow from the structure.
  virtual void ForgetValues() {}

  /// y = S x, for a solver that reads only the diagonal blocks of S.
  using Product = std::function<void(const double* x, double* y)>;
  /// True if the solver needs a product, which is set before the first Factorize and reads the same
  /// system as that.
  virtual bool NeedsProduct() const { return false; }
  virtual void SetProduct(Product /*product*/) {
    throw std::logic_error("SetProduct: expected a solver without S");
  }

  /// True if the solver reads BlockSystem::camera_diagonal.
  virtual bool NeedsCameraDiagonal() const { return false; }
  /// True for conjugate gradients, which can amplify rounding errors of S.
  virtual bool IsIterative() const { return false; }
  /// True if the solver reads BlockSystem::gauge_directions.
  virtual bool NeedsGaugeDirections() const { return false; }

  virtual FactorStatistics factor_statistics() const { return {}; }

 private:
  virtual LinearSolution DoFactorize(BlockSystem* system, const std::vector<double>& scale) = 0;
  virtual LinearSolution DoSolve(const double* rhs, int num_rhs, double eta, double* x) = 0;
  virtual LinearSolution DoInvertBlocks() {
    throw std::logic_error("InvertBlocks: expected a direct solver");
  }

  bool is_factorized_ = false;
};

}  // namespace bundle

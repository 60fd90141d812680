/// S = L L^T in place, n^3 / 3 flops, then two triangular solves of n^2 each.

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/linear/linear_solver.h"
#include "core/linear/supernodal_cholesky.h"
#include "core/parallel/blas.h"
#include "core/parallel/thread_pool.h"
#include "core/symbolic/symbolic.h"

namespace bundle::fused {

namespace {

class DenseSolver final : public LinearSolver {
 public:
  DenseSolver(const BlockStructure& structure, int num_threads)
      : num_columns_(structure.num_columns()),
        blas_threads_(num_columns_ >= kColumnsWorthBlasThreads ? EffectiveNumThreads(num_threads)
                                                               : 1) {}

  LinearSolution Solve(BlockSystem* system, const std::vector<double>& /*scale*/, double /*eta*/,
                       double* x) override {
    LinearSolution solution;
    if (num_columns_ == 0) return solution;
    std::copy(system->rhs.begin(), system->rhs.end(), x);
    const ScopedBlasThreads blas_threads(blas_threads_);
    const char lower = 'L';
    const int one = 1;
    int info = 0;
    dpotrf_(&lower, &num_columns_, system->values.data(), &num_columns_, &info);
    if (info == 0) {
      dpotrs_(&lower, &num_columns_, &one, system->values.data(), &num_columns_, x, &num_columns_,
              &info);
    }
    if (info < 0) {
      solution.status = LinearSolution::Status::kFatal;
      solution.message = "LAPACK refused argument " + std::to_string(-info) + ".";
    } else if (info > 0) {
      solution.status = LinearSolution::Status::kFailure;
      solution.message =
          "The reduced camera system is not positive definite: its leading minor of "
          "order " +
          std::to_string(info) + " is not.";
    } else if (!std::all_of(x, x + num_columns_, [](double v) { return std::isfinite(v); })) {
      solution.status = LinearSolution::Status::kFailure;
      solution.message = "The solution of the reduced camera system is not finite.";
    }
    return solution;
  }

  FactorStatistics factor_statistics() const override {
    const double n = num_columns_;
    const double entries = DenseFactorEntries(n);
    return {"natural", entries, DenseFactorFlops(n), entries, entries};
  }

 private:
  const int num_columns_;
  const int blas_threads_;
};

}  // namespace

std::unique_ptr<LinearSolver> MakeDenseSolver(const BlockStructure& structure, int num_threads) {
  return std::make_unique<DenseSolver>(structure, num_threads);
}

/// S = L L^T, supernodal: columns of L with the same rows below make one dense panel, so nearly all
/// flops are BLAS 3 (supernodal_cholesky.cpp).
///
/// S comes in the order of its elimination (supernodes.cpp), assembled in the panels of L. So
/// nothing is copied, and all there is to keep are 8 bytes an entry of L.

namespace {

/// OpenBLAS' threads pay where the panels are wide; the entries of the average column tell.
int BlasThreadsFor(const FillOrdering& ordering, int num_threads) {
  const bool wide = ordering.flops >= kColumnsWorthBlasThreads * ordering.entries;
  return wide ? EffectiveNumThreads(num_threads) : 1;
}

class SparseSolver final : public LinearSolver {
 public:
  SparseSolver(const FillOrdering& ordering, std::vector<int> offset, Supernodes supernodes,
               int num_threads)
      : statistics_{ordering.name, supernodes.entries, ordering.elimination_flops, ordering.entries,
                    supernodes.entries + supernodes.zeros},
        num_columns_(offset.back()),
        blas_threads_(BlasThreadsFor(ordering, num_threads)),
        cholesky_(std::move(offset), std::move(supernodes)) {}

  LinearSolution Solve(BlockSystem* system, const std::vector<double>& /*scale*/, double /*eta*/,
                       double* x) override {
    if (num_columns_ == 0) return {};
    const ScopedBlasThreads blas_threads(blas_threads_);
    const int minor = cholesky_.Factorize(system->values.data());
    if (minor != 0) {
      return Failure(
          "The reduced camera system is not positive definite: its leading minor of "
          "order " +
          std::to_string(minor) + " in the order of " + statistics_.ordering + " is not.");
    }
    std::copy(system->rhs.begin(), system->rhs.end(), x);
    cholesky_.Solve(system->values.data(), x);
    if (std::all_of(x, x + num_columns_, [](double v) { return std::isfinite(v); })) return {};
    return Failure("The solution of the reduced camera system is not finite.");
  }

  FactorStatistics factor_statistics() const override { return statistics_; }

 private:
  static LinearSolution Failure(std::string message) {
    return {LinearSolution::Status::kFailure, 1, std::move(message)};
  }

  const FactorStatistics statistics_;
  const int num_columns_;
  const int blas_threads_;
  SupernodalCholesky cholesky_;
};

}  // namespace

std::unique_ptr<LinearSolver> MakeSparseSolver(const FillOrdering& ordering, int num_threads,
                                               BlockStructure* structure) {
  Supernodes supernodes = FindSupernodes(*structure);
  *structure = PlaceInFactor(*structure, supernodes);
  return std::make_unique<SparseSolver>(ordering, structure->offset, std::move(supernodes),
                                        num_threads);
}

}  // namespace bundle::fused

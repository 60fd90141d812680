/// S = L L^T in place, n^3 / 3 flops, then two triangular solves of n^2 each.

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>

#include "core/blas_threads.h"
#include "core/fused/reduced/lapack.h"
#include "core/fused/reduced/reduced_solver.h"
#include "core/parallel_for.h"
#include "core/symbolic/factor_counts.h"

namespace bundle::fused {
namespace {

class DenseSolver final : public ReducedSolver {
 public:
  DenseSolver(const ReducedStructure& structure, int num_threads)
      : num_columns_(structure.num_columns()),
        blas_threads_(num_columns_ >= kColumnsWorthBlasThreads ? EffectiveNumThreads(num_threads)
                                                               : 1) {}

  ReducedSolution Solve(ReducedSystem* system, const std::vector<double>& /*scale*/, double /*eta*/,
                        double* x) override {
    ReducedSolution solution;
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
      solution.status = ReducedSolution::Status::kFatal;
      solution.message = "LAPACK refused argument " + std::to_string(-info) + ".";
    } else if (info > 0) {
      solution.status = ReducedSolution::Status::kFailure;
      solution.message =
          "The reduced camera system is not positive definite: its leading minor of "
          "order " +
          std::to_string(info) + " is not.";
    } else if (!std::all_of(x, x + num_columns_, [](double v) { return std::isfinite(v); })) {
      solution.status = ReducedSolution::Status::kFailure;
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

std::unique_ptr<ReducedSolver> MakeDenseSolver(const ReducedStructure& structure, int num_threads) {
  return std::make_unique<DenseSolver>(structure, num_threads);
}

}  // namespace bundle::fused

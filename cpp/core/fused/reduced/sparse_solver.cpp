/// S = L L^T, supernodal: columns of L with the same rows below make one dense panel, so nearly all
/// flops are BLAS 3 (supernodal_cholesky.cpp).
///
/// S comes in the order of its elimination (fill_ordering.cpp), assembled in the panels of L. So
/// nothing is copied, and all there is to keep are 8 bytes an entry of L.

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/blas_threads.h"
#include "core/fused/reduced/fill_ordering.h"
#include "core/fused/reduced/reduced_solver.h"
#include "core/fused/reduced/supernodal_cholesky.h"
#include "core/fused/reduced/supernodes.h"
#include "core/parallel_for.h"

namespace bundle::fused {
namespace {

/// OpenBLAS' threads pay where the panels are wide; the entries of the average column tell.
int BlasThreadsFor(const FillOrdering& ordering, int num_threads) {
  const bool wide = ordering.flops >= kColumnsWorthBlasThreads * ordering.entries;
  return wide ? EffectiveNumThreads(num_threads) : 1;
}

class SparseSolver final : public ReducedSolver {
 public:
  SparseSolver(const FillOrdering& ordering, std::vector<int> offset, Supernodes supernodes,
               int num_threads)
      : statistics_{ordering.name, supernodes.entries, ordering.elimination_flops, ordering.entries,
                    supernodes.entries + supernodes.zeros},
        num_columns_(offset.back()),
        blas_threads_(BlasThreadsFor(ordering, num_threads)),
        cholesky_(std::move(offset), std::move(supernodes)) {}

  ReducedSolution Solve(ReducedSystem* system, const std::vector<double>& /*scale*/, double /*eta*/,
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
  static ReducedSolution Failure(std::string message) {
    return {ReducedSolution::Status::kFailure, 1, std::move(message)};
  }

  const FactorStatistics statistics_;
  const int num_columns_;
  const int blas_threads_;
  SupernodalCholesky cholesky_;
};

}  // namespace

std::unique_ptr<ReducedSolver> MakeSparseSolver(const FillOrdering& ordering, int num_threads,
                                                ReducedStructure* structure) {
  Supernodes supernodes = FindSupernodes(*structure);
  *structure = PlaceInFactor(*structure, supernodes);
  return std::make_unique<SparseSolver>(ordering, structure->offset, std::move(supernodes),
                                        num_threads);
}

}  // namespace bundle::fused

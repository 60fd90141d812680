#include "core/linear/direct_solvers.h"

/// S = L L^T in place, n^3 / 3 flops, then two triangular solves of n^2 each per right-hand side.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/linear/linear_solver.h"
#include "core/linear/supernodal_cholesky.h"
#include "core/linear/supernodes.h"
#include "core/linear/tiled_cholesky.h"
#include "core/parallel/blas.h"
#include "core/parallel/thread_pool.h"
#include "core/symbolic/factor_counts.h"

namespace bundle {

namespace {

LinearSolution RefusedArgument(int info) {
  return {LinearStatus::kFatal, 1, "LAPACK refused argument " + std::to_string(-info) + "."};
}

/// `where`: "" or " in the order of ...".
LinearSolution NotPositiveDefinite(int minor, const std::string& where) {
  return {LinearStatus::kFailure, 1,
          "The reduced camera system is not positive definite: its leading minor of order " +
              std::to_string(minor) + where + " is not.",
          minor};
}

LinearSolution CheckFinite(const double* x, int64_t size) {
  if (std::all_of(x, x + size, [](double v) { return std::isfinite(v); })) return {};
  return {LinearStatus::kFailure, 1, "The solution of the reduced camera system is not finite."};
}

class RemoteSolver final : public LinearSolver {
 public:
  RemoteSolver(bool needs_camera_diagonal, bool is_iterative)
      : needs_camera_diagonal_(needs_camera_diagonal), is_iterative_(is_iterative) {}

  bool NeedsCameraDiagonal() const override { return needs_camera_diagonal_; }
  bool IsIterative() const override { return is_iterative_; }

 private:
  LinearSolution DoFactorize(BlockSystem* /*system*/,
                             const std::vector<double>& /*scale*/) override {
    throw std::logic_error("RemoteSolver: expected the system to be solved on rank 0");
  }
  LinearSolution DoSolve(const double* /*rhs*/, int /*num_rhs*/, double /*eta*/,
                         double* /*x*/) override {
    return {};
  }

  const bool needs_camera_diagonal_;
  const bool is_iterative_;
};

class DenseSolver final : public LinearSolver {
 public:
  DenseSolver(const BlockStructure& structure, int num_threads, bool same_bits, ThreadPool* pool)
      : num_columns_(structure.num_columns()) {
    if (has_own_kernels_) {
      pool_ = pool;
      return;
    }
    if (num_columns_ >= kColumnsWorthBlasThreads) blas_threads_ = EffectiveNumThreads(num_threads);
    if (!same_bits || num_columns_ < kColumnsWorthBlasThreads) return;
    pool_ = pool;
    if (pool_ == nullptr) {
      own_pool_ = std::make_unique<ThreadPool>(blas_threads_);
      pool_ = own_pool_.get();
    }
  }

  FactorStatistics factor_statistics() const override {
    const double n = num_columns_;
    const double entries = DenseFactorEntries(n);
    return {"natural", entries, DenseFactorFlops(n), entries, entries};
  }

 private:
  LinearSolution DoFactorize(BlockSystem* system, const std::vector<double>& /*scale*/) override {
    values_ = system->values.data();
    if (num_columns_ == 0) return {};
    if (has_own_kernels_) return Factorized(FactorizeTiled(values_, num_columns_, pool_));
    const ScopedBlasThreads blas_threads(pool_ == nullptr ? blas_threads_ : 1);
    if (pool_ != nullptr) return Factorized(FactorizeTiled(values_, num_columns_, pool_));
    int info = 0;
    dpotrf_(&kLower, &num_columns_, values_, &num_columns_, &info);
    if (info < 0) return RefusedArgument(info);
    return Factorized(info);
  }

  static LinearSolution Factorized(int info) {
    return info == 0 ? LinearSolution{} : NotPositiveDefinite(info, "");
  }

  LinearSolution DoSolve(const double* rhs, int num_rhs, double /*eta*/, double* x) override {
    if (num_columns_ == 0 || num_rhs == 0) return {};
    const int64_t size = int64_t{num_columns_} * num_rhs;
    std::copy(rhs, rhs + size, x);
    if (has_own_kernels_ && num_rhs == 1) {
      SolveTiled(values_, num_columns_, x);
      return CheckFinite(x, size);
    }
    const ScopedBlasThreads blas_threads(pool_ == nullptr ? blas_threads_ : 1);
    int info = 0;
    dpotrs_(&kLower, &num_columns_, &num_rhs, values_, &num_columns_, x, &num_columns_, &info);
    return info < 0 ? RefusedArgument(info) : CheckFinite(x, size);
  }

  LinearSolution DoInvertBlocks() override {
    if (num_columns_ == 0) return {};
    const ScopedBlasThreads blas_threads(blas_threads_);
    int info = 0;
    dpotri_(&kLower, &num_columns_, values_, &num_columns_, &info);
    return info < 0 ? RefusedArgument(info) : LinearSolution{};
  }

  static constexpr char kLower = 'L';
  double* values_ = nullptr;  ///< S, then L
  const int num_columns_;
  const bool has_own_kernels_ = HasOwnKernels(num_columns_);
  int blas_threads_ = 1;
  std::unique_ptr<ThreadPool> own_pool_;
  ThreadPool* pool_ = nullptr;  ///< for the tiled factorisation; nullptr: OpenBLAS' threads
};

}  // namespace

std::unique_ptr<LinearSolver> MakeRemoteSolver(bool needs_camera_diagonal, bool is_iterative) {
  return std::make_unique<RemoteSolver>(needs_camera_diagonal, is_iterative);
}

std::unique_ptr<LinearSolver> MakeDenseSolver(const BlockStructure& structure, int num_threads,
                                              bool same_bits, ThreadPool* pool) {
  return std::make_unique<DenseSolver>(structure, num_threads, same_bits, pool);
}

/// S = L L^T, supernodal: columns of L with the same rows below form one dense panel, so that
/// nearly all flops are products of matrices (supernodal_cholesky.cpp).
///
/// S is assembled in the panels of L, in the order of its elimination (supernodes.cpp). So no value
/// is copied, and the memory is 8 bytes per entry of L.

namespace {

/// OpenBLAS' threads are faster if the panels are wide; the average number of entries per column
/// decides.
int BlasThreadsFor(const FillOrdering& ordering, int num_threads) {
  const bool wide = ordering.flops >= kColumnsWorthBlasThreads * ordering.entries;
  return wide ? EffectiveNumThreads(num_threads) : 1;
}

/// OpenBLAS is called for the inverse and for several right-hand sides.
class SparseSolver final : public LinearSolver {
 public:
  SparseSolver(const FillOrdering& ordering, const BlockStructure& structure, Supernodes supernodes,
               int num_threads, ThreadPool* pool)
      : statistics_{ordering.name, supernodes.entries, ordering.elimination_flops, ordering.entries,
                    supernodes.entries + supernodes.zeros},
        num_columns_(structure.num_columns()),
        blas_threads_(BlasThreadsFor(ordering, num_threads)),
        pool_(pool),
        cholesky_(structure.offset, std::move(supernodes)) {
    if (pool_ != nullptr || ordering.flops < kFlopsWorthThreads) return;
    own_pool_ = std::make_unique<ThreadPool>(EffectiveNumThreads(num_threads));
    pool_ = own_pool_.get();
  }

  FactorStatistics factor_statistics() const override { return statistics_; }

 private:
  LinearSolution DoFactorize(BlockSystem* system, const std::vector<double>& /*scale*/) override {
    values_ = system->values.data();
    if (num_columns_ == 0) return {};
    const int minor = cholesky_.Factorize(values_, pool_);
    if (minor == 0) return {};
    return NotPositiveDefinite(minor, " in the order of " + statistics_.ordering);
  }

  LinearSolution DoSolve(const double* rhs, int num_rhs, double /*eta*/, double* x) override {
    if (num_columns_ == 0 || num_rhs == 0) return {};
    const int64_t size = int64_t{num_columns_} * num_rhs;
    std::copy(rhs, rhs + size, x);
    if (num_rhs == 1) {
      cholesky_.Solve(values_, x);
    } else {
      const ScopedBlasThreads blas_threads(blas_threads_);
      cholesky_.Solve(values_, x, num_rhs);
    }
    return CheckFinite(x, size);
  }

  LinearSolution DoInvertBlocks() override {
    const ScopedBlasThreads blas_threads(blas_threads_);
    cholesky_.Invert(values_);
    return {};
  }

  const FactorStatistics statistics_;
  const int num_columns_;
  const int blas_threads_;
  std::unique_ptr<ThreadPool> own_pool_;
  ThreadPool* pool_;  ///< nullptr: the caller's thread alone
  SupernodalCholesky cholesky_;
  double* values_ = nullptr;  ///< S, then L
};

}  // namespace

std::unique_ptr<LinearSolver> MakeSparseSolver(const FillOrdering& ordering, int num_threads,
                                               BlockStructure* structure, ThreadPool* pool) {
  Supernodes supernodes = FindSupernodes(*structure);
  *structure = PlaceInFactor(*structure, supernodes);
  return std::make_unique<SparseSolver>(ordering, *structure, std::move(supernodes), num_threads,
                                        pool);
}

}  // namespace bundle

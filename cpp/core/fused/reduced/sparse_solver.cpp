/// P S P^T = L L^T with CHOLMOD's supernodal Cholesky: columns of L with the same rows below make
/// one dense panel, so nearly all flops are BLAS 3.
///
/// The order P of the blocks is found on the graph of the blocks (fill_ordering.cpp) and applied by
/// blocks, so to CHOLMOD the matrix comes in its natural order, postordered, as a lower triangle:
/// the one form that it factorises without copies of its own. The panels of a reduced system are
/// the values of a compressed-column matrix whose diagonal blocks are whole; CHOLMOD passes over
/// what stands above the diagonal.
///
/// Bytes beside the system: 8 a value of S for its row index, 8 for the reordered value, 8 an entry
/// of L.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "core/blas_threads.h"
#include "core/symbolic/cholmod_session.h"
#include "core/fused/reduced/fill_ordering.h"
#include "core/fused/reduced/reduced_solver.h"
#include "core/fused/reduced/reordered_matrix.h"
#include "core/fused/reduced/serial_openmp.h"
#include "core/parallel_for.h"
#include "core/solve/memory.h"

namespace bundle::fused {
namespace {

using Clock = std::chrono::steady_clock;

/// OpenBLAS' threads pay where the panels are wide; the entries of the average column tell.
int BlasThreadsFor(const FillOrdering& ordering, int num_threads) {
  const bool wide = ordering.flops >= kColumnsWorthBlasThreads * ordering.entries;
  return wide ? EffectiveNumThreads(num_threads) : 1;
}

/// The scalar pattern of the lower triangle, diagonal blocks whole.
class ColumnPattern {
 public:
  explicit ColumnPattern(const ReducedStructure& structure) {
    column_begin_.reserve(structure.num_columns() + 1);
    rows_.reserve(structure.num_values);
    for (int j = 0; j < structure.num_blocks(); ++j) {
      for (int c = 0; c < structure.block_size(j); ++c) AddColumn(structure, j);
    }
    column_begin_.push_back(static_cast<int64_t>(rows_.size()));

    matrix.nrow = matrix.ncol = structure.num_columns();
    matrix.nzmax = rows_.size();
    matrix.p = column_begin_.data();
    matrix.i = rows_.data();
    matrix.stype = -1;
    matrix.itype = CHOLMOD_LONG;
    matrix.xtype = CHOLMOD_PATTERN;
    matrix.dtype = CHOLMOD_DOUBLE;
    matrix.sorted = 1;
    matrix.packed = 1;
  }

  cholmod_sparse* WithValues(double* values) {
    matrix.x = values;
    matrix.xtype = CHOLMOD_REAL;
    return &matrix;
  }

  cholmod_sparse matrix = {};

 private:
  void AddColumn(const ReducedStructure& structure, int j) {
    column_begin_.push_back(static_cast<int64_t>(rows_.size()));
    for (int64_t e = structure.column_begin[j]; e < structure.column_begin[j + 1]; ++e) {
      const int block = structure.row_block[e];
      for (int row = structure.offset[block]; row < structure.offset[block + 1]; ++row) {
        rows_.push_back(row);
      }
    }
  }

  std::vector<int64_t> column_begin_;
  std::vector<int64_t> rows_;
};

class SparseSolver final : public ReducedSolver {
 public:
  SparseSolver(const ReducedStructure& structure, int num_threads)
      : start_(Clock::now()),
        structure_(structure),
        num_threads_(num_threads),
        ordering_(FindFillOrdering(structure_)),
        matrix_(structure_, ordering_.order),
        pattern_(matrix_.structure()),
        blas_threads_(BlasThreadsFor(ordering_, num_threads)),
        rhs_(structure_.num_columns()) {
    if (structure_.num_columns() > 0) {
      factor_ = cholmod_l_analyze(&pattern_.matrix, &session_.common);
    }
    analysis_status_ = session_.common.status;
    symbolic_time_ = std::chrono::duration<double>(Clock::now() - start_).count();
  }

  ~SparseSolver() override {
    cholmod_l_free_factor(&factor_, &session_.common);
    cholmod_l_free_dense(&solution_, &session_.common);
    cholmod_l_free_dense(&y_workspace_, &session_.common);
    cholmod_l_free_dense(&e_workspace_, &session_.common);
  }

  ReducedSolution Solve(ReducedSystem* system, const std::vector<double>& /*scale*/, double /*eta*/,
                        double* x) override {
    if (structure_.num_columns() == 0) return {};
    if (factor_ == nullptr) return Failed(analysis_status_);
    const ScopedBlasThreads blas_threads(blas_threads_);
    const SerialOpenMp serial_openmp;
    double* values = matrix_.Reorder(&system->values, num_threads_);
    cholmod_l_factorize(pattern_.WithValues(values), factor_, &session_.common);
    if (session_.common.status != CHOLMOD_OK) return Failed(session_.common.status);
    return Substitute(system->rhs, x);
  }

  FactorStatistics factor_statistics() const override {
    return {ordering_.name, ordering_.entries, ordering_.flops, symbolic_time_};
  }

 private:
  ReducedSolution Substitute(const std::vector<double>& rhs, double* x) {
    matrix_.ReorderVector(rhs.data(), rhs_.data());
    cholmod_dense b = {};
    b.nrow = b.d = b.nzmax = rhs_.size();
    b.ncol = 1;
    b.x = rhs_.data();
    b.xtype = CHOLMOD_REAL;
    b.dtype = CHOLMOD_DOUBLE;
    cholmod_l_solve2(CHOLMOD_A, factor_, &b, nullptr, &solution_, nullptr, &y_workspace_,
                     &e_workspace_, &session_.common);
    if (session_.common.status != CHOLMOD_OK) return Failed(session_.common.status);
    const auto* reordered = static_cast<const double*>(solution_->x);
    matrix_.RestoreVector(reordered, x);
    if (std::all_of(x, x + rhs_.size(), [](double v) { return std::isfinite(v); })) return {};
    return {ReducedSolution::Status::kFailure, 1,
            "The solution of the reduced camera system is not finite."};
  }

  ReducedSolution Failed(int status) const {
    using Status = ReducedSolution::Status;
    switch (status) {
      case CHOLMOD_NOT_POSDEF:
        return {Status::kFailure, 1,
                "The reduced camera system is not positive definite: its leading minor of order " +
                    std::to_string(factor_->minor + 1) + " in the order of " + ordering_.name +
                    " is not."};
      case CHOLMOD_OUT_OF_MEMORY:
        return {Status::kFatal, 1,
                "Out of memory: the sparse factor of the reduced camera system needs " +
                    FormatBytes(8 * ordering_.entries) + "."};
      default:
        return {Status::kFatal, 1, "CHOLMOD failed with status " + std::to_string(status) + "."};
    }
  }

  const Clock::time_point start_;
  const ReducedStructure structure_;
  const int num_threads_;
  const FillOrdering ordering_;
  ReorderedMatrix matrix_;
  ColumnPattern pattern_;
  const int blas_threads_;
  std::vector<double> rhs_;
  CholmodSession session_;
  cholmod_factor* factor_ = nullptr;
  cholmod_dense* solution_ = nullptr;
  cholmod_dense* y_workspace_ = nullptr;
  cholmod_dense* e_workspace_ = nullptr;
  int analysis_status_ = CHOLMOD_OK;
  double symbolic_time_ = 0;
};

}  // namespace

std::unique_ptr<ReducedSolver> MakeSparseSolver(const ReducedStructure& structure,
                                                int num_threads) {
  return std::make_unique<SparseSolver>(structure, num_threads);
}

}  // namespace bundle::fused

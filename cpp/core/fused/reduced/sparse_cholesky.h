#pragma once

#include <cstdint>
#include <vector>

#include "core/fused/reduced/cholmod_session.h"
#include "core/fused/reduced/reduced_system.h"

namespace bundle::fused {

/// A = L L^T by CHOLMOD for a sparse structure in its own order, which is postordered
/// (fill_ordering.h); analysed once.
class SparseCholesky {
 public:
  explicit SparseCholesky(const ReducedStructure& structure);
  ~SparseCholesky();
  SparseCholesky(const SparseCholesky&) = delete;
  SparseCholesky& operator=(const SparseCholesky&) = delete;

  /// False if the matrix is not positive definite or there is not enough memory: see `status`.
  /// What stands above the diagonal in diagonal blocks has no meaning. Values are not changed.
  bool Factorize(double* values);

  /// A^-1 b after Factorize; valid until the next call. nullptr if it failed.
  const double* Solve(double* b);

  int status() const { return status_; }  ///< CHOLMOD's, of the last call or the analysis
  /// The first column whose leading minor is not positive, from 1.
  int64_t minor() const;

 private:
  std::vector<int64_t> column_begin_;
  std::vector<int64_t> rows_;
  cholmod_sparse matrix_ = {};
  CholmodSession session_;
  cholmod_factor* factor_ = nullptr;
  cholmod_dense* solution_ = nullptr;
  cholmod_dense* y_workspace_ = nullptr;
  cholmod_dense* e_workspace_ = nullptr;
  int status_ = CHOLMOD_OK;
};

}  // namespace bundle::fused

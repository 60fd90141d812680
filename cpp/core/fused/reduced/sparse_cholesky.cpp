/// A = L L^T with CHOLMOD's supernodal Cholesky: columns of L with the same rows below make one
/// dense panel, so nearly all flops are BLAS 3.
///
/// The panels of a reduced structure are the values of a compressed-column matrix whose diagonal
/// blocks are whole; CHOLMOD passes over what stands above the diagonal. A lower triangle in its
/// natural order, postordered, is the one form that it factorises without copies of its own.

#include "core/fused/reduced/sparse_cholesky.h"

#include "core/fused/reduced/serial_openmp.h"

namespace bundle::fused {

SparseCholesky::SparseCholesky(const ReducedStructure& structure) {
  column_begin_.reserve(structure.num_columns() + 1);
  rows_.reserve(structure.num_values);
  for (int j = 0; j < structure.num_blocks(); ++j) {
    for (int c = 0; c < structure.block_size(j); ++c) {
      column_begin_.push_back(static_cast<int64_t>(rows_.size()));
      for (int64_t e = structure.column_begin[j]; e < structure.column_begin[j + 1]; ++e) {
        const int block = structure.row_block[e];
        for (int row = structure.offset[block]; row < structure.offset[block + 1]; ++row) {
          rows_.push_back(row);
        }
      }
    }
  }
  column_begin_.push_back(static_cast<int64_t>(rows_.size()));

  matrix_.nrow = matrix_.ncol = structure.num_columns();
  matrix_.nzmax = rows_.size();
  matrix_.p = column_begin_.data();
  matrix_.i = rows_.data();
  matrix_.stype = -1;
  matrix_.itype = CHOLMOD_LONG;
  matrix_.xtype = CHOLMOD_PATTERN;
  matrix_.dtype = CHOLMOD_DOUBLE;
  matrix_.sorted = 1;
  matrix_.packed = 1;
  if (matrix_.ncol > 0) factor_ = cholmod_l_analyze(&matrix_, &session_.common);
  status_ = session_.common.status;
}

SparseCholesky::~SparseCholesky() {
  cholmod_l_free_factor(&factor_, &session_.common);
  cholmod_l_free_dense(&solution_, &session_.common);
  cholmod_l_free_dense(&y_workspace_, &session_.common);
  cholmod_l_free_dense(&e_workspace_, &session_.common);
}

bool SparseCholesky::Factorize(double* values) {
  if (factor_ == nullptr) return matrix_.ncol == 0;
  const SerialOpenMp serial_openmp;
  matrix_.x = values;
  matrix_.xtype = CHOLMOD_REAL;
  cholmod_l_factorize(&matrix_, factor_, &session_.common);
  status_ = session_.common.status;
  return status_ == CHOLMOD_OK;
}

const double* SparseCholesky::Solve(double* b) {
  if (factor_ == nullptr) return b;
  const SerialOpenMp serial_openmp;
  cholmod_dense rhs = {};
  rhs.nrow = rhs.d = rhs.nzmax = matrix_.ncol;
  rhs.ncol = 1;
  rhs.x = b;
  rhs.xtype = CHOLMOD_REAL;
  rhs.dtype = CHOLMOD_DOUBLE;
  cholmod_l_solve2(CHOLMOD_A, factor_, &rhs, nullptr, &solution_, nullptr, &y_workspace_,
                   &e_workspace_, &session_.common);
  status_ = session_.common.status;
  return status_ == CHOLMOD_OK ? static_cast<const double*>(solution_->x) : nullptr;
}

int64_t SparseCholesky::minor() const {
  return factor_ == nullptr ? 0 : static_cast<int64_t>(factor_->minor) + 1;
}

}  // namespace bundle::fused

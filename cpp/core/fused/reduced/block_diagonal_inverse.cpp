#include "core/fused/reduced/block_diagonal_inverse.h"

#include <Eigen/Cholesky>
#include <Eigen/Core>

namespace bundle::fused {

BlockDiagonalInverse::BlockDiagonalInverse(const ReducedStructure& structure)
    : structure_(structure),
      begin_(DiagonalBlockOffsets(structure)),
      values_(static_cast<size_t>(begin_.back())) {}

bool BlockDiagonalInverse::Invert(int block, const double* values, int stride) {
  const int size = structure_.block_size(block);
  const Eigen::Map<const Eigen::MatrixXd, 0, Eigen::OuterStride<>> matrix(
      values, size, size, Eigen::OuterStride<>(stride));
  const Eigen::LLT<Eigen::MatrixXd, Eigen::Lower> factor(matrix);
  if (factor.info() != Eigen::Success) return false;
  Eigen::Map<Eigen::MatrixXd> inverse(&values_[begin_[block]], size, size);
  inverse.setIdentity();
  factor.solveInPlace(inverse);
  return inverse.allFinite();
}

bool BlockDiagonalInverse::InvertDiagonal(const std::vector<double>& values) {
  for (int j = 0; j < structure_.num_blocks(); ++j) {
    if (!Invert(j, &values[structure_.panel_begin[j]], structure_.panel_stride[j])) return false;
  }
  return true;
}

void BlockDiagonalInverse::Multiply(const double* x, double* y) const {
  for (int j = 0; j < structure_.num_blocks(); ++j) {
    const int size = structure_.block_size(j);
    const Eigen::Map<const Eigen::MatrixXd> inverse(&values_[begin_[j]], size, size);
    const Eigen::Map<const Eigen::VectorXd> from(x + structure_.offset[j], size);
    Eigen::Map<Eigen::VectorXd> to(y + structure_.offset[j], size);
    to.noalias() = inverse.lazyProduct(from);
  }
}

}  // namespace bundle::fused

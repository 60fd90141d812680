#pragma once

#include <Eigen/Core>
#include <functional>
#include <vector>

namespace bundle {

/// Some eigenpairs of a symmetric operator.
struct EigenPairs {
  std::vector<double> values;  ///< descending
  Eigen::MatrixXd vectors;     ///< a column each, orthonormal
};

/// A symmetric positive semidefinite operator, applied to several vectors at once.
using BlockOperator = std::function<Eigen::MatrixXd(const Eigen::MatrixXd&)>;

/// The `wanted` largest eigenvalues of an operator on vectors of `size` numbers, with their
/// vectors; fewer where its range has fewer dimensions. A residual ||A x - a x|| is at most
/// `tolerance` a where the space that is searched, of `max_dimension` at most, allows it.
///
/// Eigenvalues of more than `block` dimensions are found `block` times at least. The start is the
/// same each time.
EigenPairs FindLargest(int size, int wanted, int block, int max_dimension, double tolerance,
                       const BlockOperator& apply);

/// Makes the columns of `vectors` orthonormal, and orthogonal to those of `basis`, which are.
/// Columns that depend on others are dropped.
Eigen::MatrixXd Orthonormalize(const Eigen::MatrixXd& basis, Eigen::MatrixXd vectors);

}  // namespace bundle

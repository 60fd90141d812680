#pragma once

#include <Eigen/Core>
#include <functional>
#include <vector>

namespace bundle {

/// Some eigenpairs of a symmetric operator.
struct EigenPairs {
  std::vector<double> values;  ///< descending
  Eigen::MatrixXd vectors;     ///< a column each, orthonormal
  bool converged = false;      ///< all that were wanted are known to the tolerance
};

/// A symmetric positive semidefinite operator, applied to several vectors at once.
using BlockOperator = std::function<Eigen::MatrixXd(const Eigen::MatrixXd&)>;

/// Computes the `wanted` largest eigenvalues of an operator on vectors of `size` numbers, and their
/// eigenvectors; fewer if its range has fewer dimensions. Residuals ||A x - a x|| are at most
/// `tolerance` a, unless `max_restarts` restarts of a search space of at most `max_dimension`
/// dimensions from its best vectors do not suffice.
///
/// For an eigenvalue with more than `block` dimensions, finds at least `block` eigenvectors. The
/// start is the same in each call.
EigenPairs FindLargest(int size, int wanted, int block, int max_dimension, double tolerance,
                       const BlockOperator& apply, int max_restarts = 0);

/// Makes the columns of `vectors` orthonormal, and orthogonal to the orthonormal columns of
/// `basis`. Linearly dependent columns are dropped.
Eigen::MatrixXd Orthonormalize(const Eigen::MatrixXd& basis, Eigen::MatrixXd vectors);

}  // namespace bundle

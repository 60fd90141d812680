#pragma once

/// Decompositions and products of dense matrices, compiled once: Eigen's templates for them take
/// the compiler half a minute in each file that calls them.

#include <Eigen/Core>

namespace bundle {

/// A = V diag(values) V^T of a symmetric matrix, of which the lower triangle is read.
struct SymmetricEigen {
  Eigen::VectorXd values;   ///< ascending
  Eigen::MatrixXd vectors;  ///< a column each, orthonormal
};
SymmetricEigen DecomposeSymmetric(const Eigen::MatrixXd& matrix);

/// The values alone, ascending: a fraction of the work.
Eigen::VectorXd EigenvaluesOfSymmetric(const Eigen::MatrixXd& matrix);

/// Of A = U diag(values) V^T.
struct RightSingularVectors {
  Eigen::VectorXd values;   ///< descending, as many as the smaller side of A
  Eigen::MatrixXd vectors;  ///< V, square: the last columns span the null space
};
RightSingularVectors DecomposeSingular(const Eigen::MatrixXd& matrix);

/// Descending, as many as the smaller side. Small ones are accurate to rounding of the matrix.
Eigen::VectorXd SingularValues(const Eigen::MatrixXd& matrix);

/// R of A = Q R, square, for at least as many rows as columns.
Eigen::MatrixXd TriangleOfQr(const Eigen::MatrixXd& matrix);

/// Q of A = Q R, of A's shape, for at least as many rows as columns. Columns that depend on others
/// become some direction beside them.
Eigen::MatrixXd OrthonormalColumns(const Eigen::MatrixXd& matrix);

/// U^-1 with U upper triangular and U^T U = A, which is positive definite.
Eigen::MatrixXd InverseOfCholesky(const Eigen::MatrixXd& matrix);

/// x of A x = b. Of a singular A, some x that fits best where pivots are zero.
Eigen::VectorXd SolveByFullPivoting(const Eigen::MatrixXd& a, const Eigen::VectorXd& b);

using ConstColumns = Eigen::Ref<const Eigen::MatrixXd, 0, Eigen::OuterStride<>>;

/// A B
Eigen::MatrixXd Multiply(const ConstColumns& a, const ConstColumns& b);
/// A^T B
Eigen::MatrixXd MultiplyTransposed(const ConstColumns& a, const ConstColumns& b);

}  // namespace bundle

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

/// Singular values and V of A = U diag(values) V^T.
struct RightSingularVectors {
  Eigen::VectorXd values;   ///< descending, as many as the smaller side of A
  Eigen::MatrixXd vectors;  ///< V, square: the last columns span the null space
};
RightSingularVectors DecomposeSingular(const Eigen::MatrixXd& matrix);

/// Descending, as many as the smaller side. Small ones are accurate to rounding of the matrix.
Eigen::VectorXd SingularValues(const Eigen::MatrixXd& matrix);

/// R of A = Q R, square, for at least as many rows as columns.
Eigen::MatrixXd TriangleOfQr(const Eigen::MatrixXd& matrix);
Eigen::MatrixXf TriangleOfQr(const Eigen::MatrixXf& matrix);

/// Q of A = Q R, of A's shape, for at least as many rows as columns. Columns that depend on others
/// become some direction beside them.
Eigen::MatrixXd OrthonormalColumns(const Eigen::MatrixXd& matrix);

/// U^-1 with U upper triangular and U^T U = A, which is positive definite.
Eigen::MatrixXd InverseOfCholesky(const Eigen::MatrixXd& matrix);

/// X of A X = B by Cholesky's factor. False, without X, if A is not positive definite or its
/// condition leaves no digit.
bool SolveByCholesky(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b, Eigen::MatrixXd* x);
bool SolveByCholesky(const Eigen::MatrixXf& a, const Eigen::MatrixXf& b, Eigen::MatrixXf* x);

/// X of A X = B, A positive semi-definite, in the range of A; X is zero in the null space. Rank is
/// judged in units in which A's diagonal is 1: eigenvalues up to `epsilon` times the largest and
/// A's size count as zero.
Eigen::MatrixXd SolveSemidefinite(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b,
                                  double epsilon);

/// x of A x = b. Of a singular A, some x that fits best where pivots are zero.
Eigen::VectorXd SolveByFullPivoting(const Eigen::MatrixXd& a, const Eigen::VectorXd& b);

template <typename Scalar>
using ConstColumnsOf = Eigen::Ref<const Eigen::Matrix<Scalar, Eigen::Dynamic, Eigen::Dynamic>, 0,
                                  Eigen::OuterStride<>>;
using ConstColumns = ConstColumnsOf<double>;

/// A B
Eigen::MatrixXd Multiply(const ConstColumns& a, const ConstColumns& b);
Eigen::MatrixXf Multiply(const ConstColumnsOf<float>& a, const ConstColumnsOf<float>& b);
/// A^T B
Eigen::MatrixXd MultiplyTransposed(const ConstColumns& a, const ConstColumns& b);
Eigen::MatrixXf MultiplyTransposed(const ConstColumnsOf<float>& a, const ConstColumnsOf<float>& b);

}  // namespace bundle

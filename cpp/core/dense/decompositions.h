#pragma once

/// Decompositions and products of dense matrices, compiled once. Eigen's templates for them would
/// take half a minute to compile in each file that uses them.

#include <Eigen/Core>

namespace bundle {

template <typename Scalar>
using ConstColumnsOf = Eigen::Ref<const Eigen::Matrix<Scalar, Eigen::Dynamic, Eigen::Dynamic>, 0,
                                  Eigen::OuterStride<>>;
using ConstColumns = ConstColumnsOf<double>;

/// A = V diag(values) V^T of a symmetric matrix; only the lower triangle is read.
struct SymmetricEigen {
  Eigen::VectorXd values;   ///< ascending
  Eigen::MatrixXd vectors;  ///< a column each, orthonormal
};
SymmetricEigen DecomposeSymmetric(const Eigen::MatrixXd& matrix);

/// The unit eigenvector of the largest eigenvalue of a symmetric matrix.
Eigen::Vector4d LargestEigenvector(const Eigen::Matrix4d& matrix);

/// The eigenvalues alone, ascending, which takes a fraction of the time.
Eigen::VectorXd EigenvaluesOfSymmetric(const Eigen::MatrixXd& matrix);

/// Singular values and V of A = U diag(values) V^T.
struct RightSingularVectors {
  Eigen::VectorXd values;   ///< descending, as many as the smaller side of A
  Eigen::MatrixXd vectors;  ///< V, square: the last columns span the null space
};
RightSingularVectors DecomposeSingular(const Eigen::MatrixXd& matrix);

/// Singular values, descending, as many as the smaller side. Small ones are accurate to the
/// rounding of the matrix.
Eigen::VectorXd SingularValues(const Eigen::MatrixXd& matrix);

/// R of A = Q R, square, for at least as many rows as columns.
Eigen::MatrixXd TriangleOfQr(const Eigen::MatrixXd& matrix);
Eigen::MatrixXf TriangleOfQr(const Eigen::MatrixXf& matrix);

/// R of A = Q R, with as many rows as A's smaller side; `others` becomes Q^T others.
Eigen::MatrixXd ApplyQr(const Eigen::MatrixXd& matrix, Eigen::MatrixXd* others);

/// Q of A = Q R, of A's shape, for at least as many rows as columns. Linearly dependent columns are
/// replaced by arbitrary directions orthogonal to the others.
Eigen::MatrixXd OrthonormalColumns(const Eigen::MatrixXd& matrix);

/// U^-1 with U upper triangular and U^T U = A, which is positive definite.
Eigen::MatrixXd InverseOfCholesky(const Eigen::MatrixXd& matrix);

/// Solves A X = B by the Cholesky factor. Returns false if A is not positive definite or too
/// ill-conditioned for a correct digit.
bool SolveByCholesky(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b, Eigen::MatrixXd* x);
bool SolveByCholesky(const Eigen::MatrixXf& a, const Eigen::MatrixXf& b, Eigen::MatrixXf* x);

/// The same for one b. Returns false if the square of a pivot is less than `least`.
bool SolveByCholesky(const Eigen::MatrixXd& a, const Eigen::VectorXd& b, double least,
                     Eigen::VectorXd* x);

/// A^-1 by the Cholesky factor; reads the lower triangle. Returns false if A is not positive
/// definite.
bool InvertByCholesky(const ConstColumns& a, Eigen::Ref<Eigen::MatrixXd> inverse);

/// X of A X = B, for A positive semidefinite and B in its range; X is zero in the null space. The
/// rank is determined with A's diagonal scaled to 1: eigenvalues up to `epsilon` times the largest
/// and A's size count as zero.
Eigen::MatrixXd SolveSemidefinite(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b,
                                  double epsilon);

/// x of A x = b. For a singular A, a best fit with zeros at zero pivots.
Eigen::VectorXd SolveByFullPivoting(const Eigen::MatrixXd& a, const Eigen::VectorXd& b);

/// A B
Eigen::MatrixXd Multiply(const ConstColumns& a, const ConstColumns& b);
Eigen::MatrixXf Multiply(const ConstColumnsOf<float>& a, const ConstColumnsOf<float>& b);
/// A^T B
Eigen::MatrixXd MultiplyTransposed(const ConstColumns& a, const ConstColumns& b);
Eigen::MatrixXf MultiplyTransposed(const ConstColumnsOf<float>& a, const ConstColumnsOf<float>& b);

}  // namespace bundle

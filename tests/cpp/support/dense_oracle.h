#pragma once

/// Dense algebra that tests compare with, compiled once: Eigen's templates for it take most of the
/// time that tests take to compile.

#include <Eigen/Core>

namespace bundle::oracle {

using Real = long double;
using RealMatrix = Eigen::Matrix<Real, Eigen::Dynamic, Eigen::Dynamic>;
using RealVector = Eigen::Matrix<Real, Eigen::Dynamic, 1>;

/// A B
RealMatrix Product(const RealMatrix& a, const RealMatrix& b);
/// A^-1 B of a symmetric A, in extended precision.
RealMatrix SolveSymmetric(const RealMatrix& a, const RealMatrix& b);
Eigen::MatrixXd Inverse(const Eigen::MatrixXd& a);
/// L of A = L L^T.
Eigen::MatrixXd CholeskyFactor(const Eigen::MatrixXd& a);
/// x for which ||A x - b|| is least.
Eigen::VectorXd SolveLeastSquares(const Eigen::MatrixXd& a, const Eigen::VectorXd& b);

}  // namespace bundle::oracle

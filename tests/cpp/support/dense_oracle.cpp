#include "support/dense_oracle.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <Eigen/QR>

namespace bundle::oracle {

RealMatrix Product(const RealMatrix& a, const RealMatrix& b) { return a * b; }

RealMatrix SolveSymmetric(const RealMatrix& a, const RealMatrix& b) {
  if (a.rows() == 0) return b;
  return a.ldlt().solve(b);
}

Eigen::MatrixXd Inverse(const Eigen::MatrixXd& a) { return a.inverse(); }

Eigen::MatrixXd CholeskyFactor(const Eigen::MatrixXd& a) {
  if (a.rows() == 0) return a;
  return a.llt().matrixL();
}

Eigen::VectorXd SolveLeastSquares(const Eigen::MatrixXd& a, const Eigen::VectorXd& b) {
  return a.householderQr().solve(b);
}

}  // namespace bundle::oracle

#include "core/dense/decompositions.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <Eigen/QR>
#include <Eigen/SVD>

namespace bundle {

using Eigen::MatrixXd;
using Eigen::VectorXd;

SymmetricEigen DecomposeSymmetric(const MatrixXd& matrix) {
  const Eigen::SelfAdjointEigenSolver<MatrixXd> solver(matrix);
  return {solver.eigenvalues(), solver.eigenvectors()};
}

VectorXd EigenvaluesOfSymmetric(const MatrixXd& matrix) {
  return Eigen::SelfAdjointEigenSolver<MatrixXd>(matrix, Eigen::EigenvaluesOnly).eigenvalues();
}

// Jacobi's rotations find small singular values to the last digit, and compile in half the time of
// Eigen's divide and conquer.
RightSingularVectors DecomposeSingular(const MatrixXd& matrix) {
  const Eigen::JacobiSVD<MatrixXd> solver(matrix, Eigen::ComputeFullV);
  return {solver.singularValues(), solver.matrixV()};
}

VectorXd SingularValues(const MatrixXd& matrix) {
  return Eigen::JacobiSVD<MatrixXd>(matrix).singularValues();
}

MatrixXd TriangleOfQr(const MatrixXd& matrix) {
  return Eigen::HouseholderQR<MatrixXd>(matrix)
      .matrixQR()
      .topRows(matrix.cols())
      .triangularView<Eigen::Upper>();
}

MatrixXd OrthonormalColumns(const MatrixXd& matrix) {
  return Eigen::HouseholderQR<MatrixXd>(matrix).householderQ() *
         MatrixXd::Identity(matrix.rows(), matrix.cols());
}

MatrixXd InverseOfCholesky(const MatrixXd& matrix) {
  MatrixXd inverse = MatrixXd::Identity(matrix.rows(), matrix.cols());
  matrix.llt().matrixU().solveInPlace(inverse);
  return inverse;
}

VectorXd SolveByFullPivoting(const MatrixXd& a, const VectorXd& b) {
  return Eigen::FullPivLU<MatrixXd>(a).setThreshold(0.0).solve(b);
}

MatrixXd Multiply(const ConstColumns& a, const ConstColumns& b) { return a * b; }

MatrixXd MultiplyTransposed(const ConstColumns& a, const ConstColumns& b) {
  return a.transpose() * b;
}

}  // namespace bundle

#include "core/dense/decompositions.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <Eigen/QR>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <limits>

namespace bundle {

using Eigen::MatrixXd;
using Eigen::MatrixXf;
using Eigen::VectorXd;

namespace {

template <typename Matrix>
Matrix Triangle(const Matrix& matrix) {
  return Eigen::HouseholderQR<Matrix>(matrix)
      .matrixQR()
      .topRows(matrix.cols())
      .template triangularView<Eigen::Upper>();
}

template <typename Matrix>
bool SolvePositive(const Matrix& a, const Matrix& b, Matrix* x) {
  using Scalar = typename Matrix::Scalar;
  const Eigen::LLT<Matrix> llt(a);
  const bool is_positive =
      llt.info() == Eigen::Success && llt.rcond() > std::numeric_limits<Scalar>::epsilon();
  if (is_positive) *x = llt.solve(b);
  return is_positive;
}

}  // namespace

SymmetricEigen DecomposeSymmetric(const MatrixXd& matrix) {
  const Eigen::SelfAdjointEigenSolver<MatrixXd> solver(matrix);
  return {solver.eigenvalues(), solver.eigenvectors()};
}

Eigen::Vector4d LargestEigenvector(const Eigen::Matrix4d& matrix) {
  return DecomposeSymmetric(matrix).vectors.col(3);
}

VectorXd EigenvaluesOfSymmetric(const MatrixXd& matrix) {
  return Eigen::SelfAdjointEigenSolver<MatrixXd>(matrix, Eigen::EigenvaluesOnly).eigenvalues();
}

// Jacobi rotations compute small singular values to the last digit, and compile in half the time of
// Eigen's divide and conquer.
RightSingularVectors DecomposeSingular(const MatrixXd& matrix) {
  const Eigen::JacobiSVD<MatrixXd> solver(matrix, Eigen::ComputeFullV);
  return {solver.singularValues(), solver.matrixV()};
}

VectorXd SingularValues(const MatrixXd& matrix) {
  return Eigen::JacobiSVD<MatrixXd>(matrix).singularValues();
}

MatrixXd TriangleOfQr(const MatrixXd& matrix) { return Triangle(matrix); }

MatrixXf TriangleOfQr(const MatrixXf& matrix) { return Triangle(matrix); }

MatrixXd ApplyQr(const MatrixXd& matrix, MatrixXd* others) {
  const Eigen::HouseholderQR<MatrixXd> qr(matrix);
  others->applyOnTheLeft(qr.householderQ().adjoint());
  return qr.matrixQR()
      .topRows(std::min(matrix.rows(), matrix.cols()))
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

bool SolveByCholesky(const MatrixXd& a, const MatrixXd& b, MatrixXd* x) {
  return SolvePositive(a, b, x);
}

bool SolveByCholesky(const MatrixXf& a, const MatrixXf& b, MatrixXf* x) {
  return SolvePositive(a, b, x);
}

bool SolveByCholesky(const MatrixXd& a, const VectorXd& b, double least, VectorXd* x) {
  const Eigen::LLT<MatrixXd> llt(a);
  if (llt.info() != Eigen::Success) return false;
  if (llt.matrixLLT().diagonal().cwiseAbs2().minCoeff() < least) return false;
  *x = llt.solve(b);
  return true;
}

bool InvertByCholesky(const ConstColumns& a, Eigen::Ref<MatrixXd> inverse) {
  const Eigen::LLT<MatrixXd> llt(a);
  if (llt.info() != Eigen::Success) return false;
  inverse.setIdentity();
  llt.solveInPlace(inverse);
  return true;
}

MatrixXd SolveSemidefinite(const MatrixXd& a, const MatrixXd& b, double epsilon) {
  VectorXd scale = a.diagonal();
  for (double& entry : scale) entry = entry > 0 ? 1 / std::sqrt(entry) : 0;
  const SymmetricEigen eigen = DecomposeSymmetric(scale.asDiagonal() * a * scale.asDiagonal());
  VectorXd inverse = eigen.values;
  const double least = epsilon * double(inverse.size()) * std::max(inverse.maxCoeff(), 0.0);
  for (double& x : inverse) x = x > least ? 1 / x : 0;
  const MatrixXd turned =
      inverse.asDiagonal() * MultiplyTransposed(eigen.vectors, scale.asDiagonal() * b);
  return scale.asDiagonal() * Multiply(eigen.vectors, turned);
}

VectorXd SolveByFullPivoting(const MatrixXd& a, const VectorXd& b) {
  return Eigen::FullPivLU<MatrixXd>(a).setThreshold(0.0).solve(b);
}

MatrixXd Multiply(const ConstColumns& a, const ConstColumns& b) { return a * b; }

MatrixXf Multiply(const ConstColumnsOf<float>& a, const ConstColumnsOf<float>& b) { return a * b; }

MatrixXd MultiplyTransposed(const ConstColumns& a, const ConstColumns& b) {
  return a.transpose() * b;
}

MatrixXf MultiplyTransposed(const ConstColumnsOf<float>& a, const ConstColumnsOf<float>& b) {
  return a.transpose() * b;
}

}  // namespace bundle

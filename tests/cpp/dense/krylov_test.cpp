#include "core/dense/krylov.h"

#include <gtest/gtest.h>

#include <random>

#include "core/dense/decompositions.h"

namespace bundle {
namespace {

Eigen::MatrixXd Random(int rows, int columns, int seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  Eigen::MatrixXd matrix(rows, columns);
  for (double& entry : matrix.reshaped()) entry = normal(random);
  return matrix;
}

/// Symmetric, with these eigenvalues.
Eigen::MatrixXd WithEigenvalues(const Eigen::VectorXd& values) {
  const auto n = static_cast<int>(values.size());
  const Eigen::MatrixXd q = OrthonormalColumns(Random(n, n, 1));
  return q * values.asDiagonal() * q.transpose();
}

TEST(Krylov, FindsTheLargestEigenpairs) {
  Eigen::VectorXd values = Eigen::VectorXd::LinSpaced(300, 0, 1).array().square();
  values.tail(6) << 20, 20, 20, 50, 1e3, 1e10;
  const Eigen::MatrixXd a = WithEigenvalues(values);
  const EigenPairs found = FindLargest(
      300, 6, 4, 200, 1e-8, [&](const Eigen::MatrixXd& x) { return Eigen::MatrixXd(a * x); });
  ASSERT_EQ(found.values.size(), 6u);
  const double expected[] = {1e10, 1e3, 50, 20, 20, 20};
  for (int k = 0; k < 6; ++k) EXPECT_NEAR(found.values[k] / expected[k], 1, 1e-6) << k;
  EXPECT_LT((found.vectors.transpose() * found.vectors - Eigen::MatrixXd::Identity(6, 6)).norm(),
            1e-10);
}

TEST(Krylov, StopsWhereTheRangeEnds) {
  Eigen::VectorXd values = Eigen::VectorXd::Zero(40);
  values.head(3) << 3, 2, 1;
  const Eigen::MatrixXd a = WithEigenvalues(values);
  const EigenPairs found = FindLargest(
      40, 8, 8, 40, 1e-8, [&](const Eigen::MatrixXd& x) { return Eigen::MatrixXd(a * x); });
  ASSERT_EQ(found.values.size(), 3u);
  for (int k = 0; k < 3; ++k) EXPECT_NEAR(found.values[k], 3 - k, 1e-10);
}

TEST(Krylov, OrthonormalColumnsLeaveOutWhatDependsOnOthers) {
  const Eigen::MatrixXd basis = Orthonormalize(Eigen::MatrixXd(20, 0), Random(20, 3, 2));
  Eigen::MatrixXd more = Random(20, 4, 3);
  more.col(1) = basis * Random(3, 1, 4);  // within the basis
  more.col(3) = 1e6 * more.col(0) - more.col(2);
  const Eigen::MatrixXd found = Orthonormalize(basis, more);
  ASSERT_EQ(found.cols(), 2);
  EXPECT_LT((basis.transpose() * found).norm(), 1e-13);
  EXPECT_LT((found.transpose() * found - Eigen::MatrixXd::Identity(2, 2)).norm(), 1e-13);
}

TEST(Krylov, NearlyParallelColumnsStayOrthogonalToTheBasis) {
  const Eigen::MatrixXd basis = Orthonormalize(Eigen::MatrixXd(50, 0), Random(50, 10, 5));
  Eigen::MatrixXd more = Random(50, 3, 6) + 10 * basis * Random(10, 3, 7);
  more.col(1) = more.col(0) + 1e-6 * more.col(1);
  more.col(2) = more.col(0) - 1e-7 * more.col(2);
  const Eigen::MatrixXd found = Orthonormalize(basis, more);
  ASSERT_EQ(found.cols(), 3);
  EXPECT_LT((basis.transpose() * found).norm(), 1e-13);
  EXPECT_LT((found.transpose() * found - Eigen::MatrixXd::Identity(3, 3)).norm(), 1e-13);
}

TEST(Krylov, ALongSearchMeetsItsTolerance) {
  // The range of a chain's normal equations: neighbouring eigenvalues need many dimensions.
  const Eigen::MatrixXd a =
      WithEigenvalues(Eigen::VectorXd::LinSpaced(400, 1e-3, 1).array().pow(2));
  const EigenPairs found = FindLargest(
      400, 2, 2, 160, 1e-4, [&](const Eigen::MatrixXd& x) { return Eigen::MatrixXd(a * x); });
  ASSERT_EQ(found.values.size(), 2u);
  for (int k = 0; k < 2; ++k) {
    const Eigen::VectorXd x = found.vectors.col(k);
    EXPECT_LT((a * x - found.values[k] * x).norm(), 1.01e-4 * found.values[k]) << k;
  }
  EXPECT_NEAR(found.values[0], 1, 1e-3);
}

}  // namespace
}  // namespace bundle

#include "core/linear/tiled_cholesky.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cstdlib>

#include "core/parallel/blas.h"

namespace bundle {
namespace {

/// A sum of few products of columns, which takes no longer than the factorisation.
Eigen::MatrixXd PositiveDefinite(int n) {
  std::srand(n);
  const Eigen::MatrixXd root = Eigen::MatrixXd::Random(n, std::min(n + 3, 40));
  return root * root.transpose() + 0.1 * Eigen::MatrixXd::Identity(n, n);
}

Eigen::MatrixXd Factor(Eigen::MatrixXd a, int num_threads, int* info) {
  const ScopedBlasThreads blas_threads(1);
  ThreadPool pool(num_threads);
  *info = FactorizeTiled(a.data(), static_cast<int>(a.rows()), &pool);
  return a.triangularView<Eigen::Lower>();
}

class TiledCholesky : public testing::TestWithParam<int> {};

// Around one and several tiles of 96 and 256, with one thread and several.
INSTANTIATE_TEST_SUITE_P(Sizes, TiledCholesky,
                         testing::Values(1, 7, 255, 256, 257, 511, 700, 2100));

TEST_P(TiledCholesky, IsTheFactor) {
  const Eigen::MatrixXd a = PositiveDefinite(GetParam());
  int info = -1;
  const Eigen::MatrixXd factor = Factor(a, 2, &info);
  EXPECT_EQ(info, 0);
  // A triangle with a positive diagonal and L L^T = A is the only one. Of random vectors, the two
  // products differ if the matrices do.
  EXPECT_GT(factor.diagonal().minCoeff(), 0);
  const Eigen::MatrixXd x = Eigen::MatrixXd::Random(a.rows(), 3);
  const Eigen::MatrixXd product = factor * (factor.transpose() * x);
  EXPECT_LE((product - a * x).norm(), 2e-15 * a.norm() * x.norm());
}

TEST_P(TiledCholesky, HasTheSameBitsForAnyNumberOfThreads) {
  const Eigen::MatrixXd a = PositiveDefinite(GetParam());
  int info = -1;
  const Eigen::MatrixXd one = Factor(a, 1, &info);
  for (const int num_threads : {2, 3, 5}) EXPECT_EQ(one, Factor(a, num_threads, &info));
}

TEST_P(TiledCholesky, NamesTheMinorThatIsNotPositive) {
  Eigen::MatrixXd a = PositiveDefinite(GetParam());
  int info = -1;
  for (const int row : {0, GetParam() / 2, GetParam() - 1}) {
    Eigen::MatrixXd bad = a;
    bad(row, row) = -1;
    Factor(bad, 2, &info);
    EXPECT_EQ(info, row + 1);
  }
}

TEST_P(TiledCholesky, Solves) {
  const Eigen::MatrixXd a = PositiveDefinite(GetParam());
  int info = -1;
  const Eigen::MatrixXd factor = Factor(a, 2, &info);
  const Eigen::VectorXd expected = Eigen::VectorXd::Random(a.rows());
  Eigen::VectorXd x = a * expected;
  SolveTiled(factor.data(), static_cast<int>(a.rows()), x.data());
  EXPECT_LE((a * (x - expected)).norm(), 1e-11 * (a * expected).norm());
}

TEST(TiledCholeskyOfNothing, IsNothing) {
  ThreadPool pool(2);
  EXPECT_EQ(FactorizeTiled(nullptr, 0, &pool), 0);
}

}  // namespace
}  // namespace bundle

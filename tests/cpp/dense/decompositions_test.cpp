#include "core/dense/decompositions.h"

#include <gtest/gtest.h>

#include <limits>

namespace bundle {
namespace {

TEST(SolveSemidefinite, LeavesOutWhatTheMatrixDoesNotSay) {
  // With diag(1/2, 1, 0) on both sides: [1 1; 1 1] and zeros, whose pseudo-inverse is [1 1; 1 1]
  // / 4.
  Eigen::MatrixXd a(3, 3), b(3, 2), expected(3, 2);
  a << 4, 2, 0, 2, 1, 0, 0, 0, 0;
  b << 4, 8, 2, 4, 0, 0;
  expected << 0.5, 1, 1, 2, 0, 0;
  const Eigen::MatrixXd x = SolveSemidefinite(a, b, std::numeric_limits<double>::epsilon());
  EXPECT_LT((x - expected).cwiseAbs().maxCoeff(), 1e-14);
}

TEST(SolveSemidefinite, TakesSmallEigenvaluesForZeroInThePrecisionAsked) {
  Eigen::MatrixXd a(2, 2), b(2, 1);
  a << 1, 1 - 1e-9, 1 - 1e-9, 1;
  b << 1, 0;
  const double exact = SolveSemidefinite(a, b, std::numeric_limits<double>::epsilon())(0, 0);
  EXPECT_NEAR(exact, 0.5e9, 1e2);
  const double single = SolveSemidefinite(a, b, std::numeric_limits<float>::epsilon())(0, 0);
  EXPECT_NEAR(single, 0.25, 1e-8);
}

TEST(SolveByCholesky, RefusesWhatHasNoDigitLeft) {
  Eigen::MatrixXd a(2, 2), b(2, 1), x;
  a << 4, 2, 2, 3;
  b << 8, 8;
  ASSERT_TRUE(SolveByCholesky(a, b, &x));
  EXPECT_LT((a * x - b).cwiseAbs().maxCoeff(), 1e-14);
  Eigen::MatrixXf single;
  ASSERT_TRUE(SolveByCholesky(Eigen::MatrixXf(a.cast<float>()), b.cast<float>(), &single));
  EXPECT_LT((single.cast<double>() - x).cwiseAbs().maxCoeff(), 1e-6);
  const Eigen::MatrixXd flat = Eigen::MatrixXd::Ones(2, 2);
  EXPECT_FALSE(SolveByCholesky(flat, b, &x));
  a << 1, 1 - 1e-9, 1 - 1e-9, 1;  // fit for double precision alone
  EXPECT_TRUE(SolveByCholesky(a, b, &x));
  EXPECT_FALSE(SolveByCholesky(Eigen::MatrixXf(a.cast<float>()), b.cast<float>(), &single));
  a << 1, 0, 0, -1;
  EXPECT_FALSE(SolveByCholesky(a, b, &x));
}

TEST(SolveByCholesky, RefusesPivotsWhoseSquareIsSmaller) {
  Eigen::MatrixXd a(2, 2);
  a << 4, 2, 2, 3;  // the squares of its pivots are 4 and 2
  const Eigen::VectorXd b = Eigen::Vector2d(8, 8);
  Eigen::VectorXd x;
  EXPECT_FALSE(SolveByCholesky(a, b, 2.001, &x));
  ASSERT_TRUE(SolveByCholesky(a, b, 1.999, &x));
  EXPECT_LT((x - Eigen::Vector2d(1, 2)).norm(), 1e-14);
  a(1, 1) = 0.999;
  EXPECT_FALSE(SolveByCholesky(a, b, 0, &x));
}

TEST(InvertByCholesky, ReadsTheLowerTriangleAndWritesABlock) {
  Eigen::MatrixXd a(2, 2), all = Eigen::MatrixXd::Zero(3, 3), expected = all;
  a << 4, 100, 2, 3;
  expected.topLeftCorner(2, 2) << 0.375, -0.25, -0.25, 0.5;
  ASSERT_TRUE(InvertByCholesky(a, all.topLeftCorner(2, 2)));
  EXPECT_LT((all - expected).cwiseAbs().maxCoeff(), 1e-15);
  a(1, 1) = 0.999;
  EXPECT_FALSE(InvertByCholesky(a, all.topLeftCorner(2, 2)));
}

}  // namespace
}  // namespace bundle

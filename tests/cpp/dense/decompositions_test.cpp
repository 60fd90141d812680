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

}  // namespace
}  // namespace bundle

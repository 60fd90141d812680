#include "core/ceres/gradient_check.h"

#include <bundle/numeric_jacobian.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

namespace bundle {
namespace {

/// sin x as the difference of two large numbers, as a residual is of a pixel and a measurement.
class LargeDifference final : public ceres::CostFunction {
 public:
  explicit LargeDifference(double minuend) : minuend_(minuend) {
    set_num_residuals(1);
    mutable_parameter_block_sizes()->push_back(1);
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** /*jacobians*/) const override {
    const volatile double sum = minuend_ + std::sin(parameters[0][0]);
    residuals[0] = sum - minuend_;
    return true;
  }

 private:
  const double minuend_;
};

/// Moving the parameter by its last digits shows nothing of the rounding of a far larger number:
/// it has to be known, for the bound on the error to hold.
TEST(DifferentiateByRichardson, KnowsTheRoundingOfWhatAResidualIsTheDifferenceOf) {
  constexpr double kMinuend = 1e6;
  const LargeDifference cost(kMinuend);
  KnownScales known;
  known.minuends = {kMinuend};
  double largest_bound = 0;
  for (int k = 0; k < 500; ++k) {
    const double x = 0.3 + 0.002 * k;
    const ReferenceJacobians found = DifferentiateByRichardson(cost, {nullptr}, {&x}, known);
    const double error = std::abs(found.ambient.values[0] - std::cos(x));
    EXPECT_LE(error, found.ambient.uncertainty[0]) << x;
    largest_bound = std::max(largest_bound, found.ambient.uncertainty[0]);
  }
  EXPECT_LT(largest_bound, 1e-6);
}

/// Its rounding is that of the residual itself: the last digits of the parameter move nothing.
class FarFromZero final : public ceres::SizedCostFunction<1, 1> {
 public:
  bool Evaluate(double const* const* parameters, double* residuals,
                double** /*jacobians*/) const override {
    residuals[0] = 1e6 + std::sin(parameters[0][0]);
    return true;
  }
};

TEST(DifferentiateByRichardson, KnowsTheRoundingOfALargeResidual) {
  double largest_bound = 0;
  for (int k = 0; k < 500; ++k) {
    const double x = 0.3 + 0.002 * k;
    const ReferenceJacobians found = DifferentiateByRichardson(FarFromZero(), {nullptr}, {&x});
    const double error = std::abs(found.ambient.values[0] - std::cos(x));
    EXPECT_LE(error, found.ambient.uncertainty[0]) << x;
    largest_bound = std::max(largest_bound, found.ambient.uncertainty[0]);
  }
  EXPECT_LT(largest_bound, 1e-6);
}

/// x y z, whose derivatives by one parameter need the others where they are.
class Product final : public ceres::SizedCostFunction<1, 3> {
 public:
  explicit Product(double factor = 1) : factor_(factor) {}

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const double* const x = parameters[0];
    residuals[0] = x[0] * x[1] * x[2];
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    for (int j = 0; j < 3; ++j) jacobians[0][j] = factor_ * x[(j + 1) % 3] * x[(j + 2) % 3];
    return true;
  }

 private:
  const double factor_;
};

/// After each column, of the tangent space too, the parameters are back where they were.
TEST(DifferentiateByRichardson, MovesOneParameterAtATime) {
  const double x[3] = {2, 3, 5};
  const ceres::EuclideanManifold<3> manifold;
  const ReferenceJacobians found = DifferentiateByRichardson(Product(), {&manifold}, {x});
  for (int j = 0; j < 3; ++j) {
    const double exact = x[(j + 1) % 3] * x[(j + 2) % 3];
    for (const NumericJacobian& jacobian : {found.ambient, found.tangent}) {
      ASSERT_EQ(jacobian.values.size(), 3u);
      EXPECT_LE(std::abs(jacobian.values[j] - exact), jacobian.uncertainty[j]) << j;
      EXPECT_LT(jacobian.uncertainty[j], 1e-10);
    }
  }
}

// Ceres' library allocates matrices that its caller frees, and with AddressSanitizer Eigen does the
// two in different ways: it takes malloc for unaligned there.
TEST(RunGradientChecker, TellsRightFromWrong) {
#if defined(__SANITIZE_ADDRESS__)
  GTEST_SKIP() << "Ceres' library was built without AddressSanitizer";
#endif
  const double x[3] = {2, 3, 5};
  const GradientCheckerProbe right = RunGradientChecker(Product(), {nullptr}, {x}, 1e-7);
  EXPECT_TRUE(right.agrees) << right.message;
  ASSERT_EQ(right.local_numeric_jacobian.size(), 3u);
  EXPECT_NEAR(right.local_numeric_jacobian[1], 10, 1e-6);
  EXPECT_FALSE(RunGradientChecker(Product(1.001), {nullptr}, {x}, 1e-7).agrees);
}

/// Large values beside small ones, with different errors of truncation.
class UnequalRows final : public ceres::SizedCostFunction<2, 1> {
 public:
  bool Evaluate(double const* const* parameters, double* residuals,
                double** /*jacobians*/) const override {
    residuals[0] = parameters[0][0];
    residuals[1] = 1e-12 * std::exp(20 * parameters[0][0]);
    return true;
  }
};

TEST(DifferentiateByRichardson, IsAsExactForSmallValuesAsForLargeOnes) {
  const double x = 1e-3;
  const ReferenceJacobians found = DifferentiateByRichardson(UnequalRows(), {nullptr}, {&x});
  const double exact = 20e-12 * std::exp(20 * x);
  EXPECT_NEAR(found.ambient.values[1], exact, 1e-9 * exact);
  EXPECT_LT(found.ambient.uncertainty[1], 1e-8 * exact);
}

/// Along x in jumps, and along y too little for one.
class Jumps final : public ceres::SizedCostFunction<1, 2> {
 public:
  bool Evaluate(double const* const* parameters, double* residuals,
                double** /*jacobians*/) const override {
    const double exact = parameters[0][0] + 1e-3 * parameters[0][1];
    residuals[0] = 1e-3 * std::round(1e3 * exact);
    return true;
  }
};

TEST(DifferentiateByRichardson, AValueThatStandsStillMayHaveASlopeBelowItsJumps) {
  const double xy[2] = {1, 1};
  const ReferenceJacobians found = DifferentiateByRichardson(Jumps(), {nullptr}, {xy});
  EXPECT_EQ(found.ambient.values[1], 0);
  EXPECT_GT(found.ambient.uncertainty[1], 1e-3);
  EXPECT_LT(found.ambient.uncertainty[1], 1);
}

}  // namespace
}  // namespace bundle

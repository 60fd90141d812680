// The search along a projected step, on functions of one number; against_ceres_test.cpp has it
// within solves.

#include "core/minimize/projected_line_search.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <utility>
#include <vector>

namespace bundle {
namespace {

/// A path phi(a), its slope, and where it was evaluated.
class Path final : public LeastSquares {
 public:
  using Function = std::function<double(double)>;

  Path(Function value, Function slope, double max_norm = 1)
      : value_(std::move(value)), slope_(std::move(slope)), max_norm_(max_norm) {}

  Linearization Linearize(double) override { return {}; }
  NewtonResult SolveNewton(double) override { return {}; }
  Candidate EvaluateNewtonStep() override { return {}; }
  DoglegProducts Products() override { return {}; }
  Candidate EvaluateDoglegStep(double, double) override { return {}; }
  void Accept() override {}
  double StateNorm() const override { return 1; }

  StepLine LineAlongStep() override { return {slope_(0), max_norm_}; }
  Candidate EvaluateAlongStep(double a) override {
    evaluated.push_back(a);
    return {0, a, value_(a), 0, a < 0.5};
  }
  double SlopeAtCandidate() override { return slope_(evaluated.empty() ? 1 : evaluated.back()); }

  Candidate Search() {
    Candidate candidate{7, 1, value_(1), false};
    SearchAlongStep(value_(0), this, &candidate);
    return candidate;
  }

  std::vector<double> evaluated;

 private:
  Function value_, slope_;
  double max_norm_;
};

TEST(ProjectedLineSearch, LeavesAStepThatLowersTheCostEnough) {
  Path path([](double a) { return 1 - 2e-4 * a; }, [](double) { return -1.0; });
  EXPECT_EQ(path.Search().step_norm, 1);
  EXPECT_TRUE(path.evaluated.empty());
}

TEST(ProjectedLineSearch, ShortensAStepThatDoesNot) {
  Path path([](double a) { return 1 - 0.5e-4 * a; }, [](double) { return -1.0; });
  EXPECT_GT(path.Search().step_norm, 0);
  EXPECT_FALSE(path.evaluated.empty());
}

TEST(ProjectedLineSearch, FindsTheMinimumOfACubicAtOnce) {
  // Minimum at 1/4, between 1/1000 and 0.6 of the whole step.
  Path path([](double a) { return 3 - 3 * a + 4 * a * a + 16.0 / 3 * a * a * a; },
            [](double a) { return -3 + 8 * a + 16 * a * a; });
  const Candidate found = path.Search();
  ASSERT_EQ(path.evaluated.size(), 1u);
  EXPECT_NEAR(path.evaluated[0], 0.25, 1e-12);
  EXPECT_EQ(found.step_norm, path.evaluated[0]);
  EXPECT_EQ(found.model_cost_change, 7);  // of the whole step
  EXPECT_TRUE(found.changes_what_counts);
}

TEST(ProjectedLineSearch, FitsADegreeOfFiveFromTheSecondStepOn) {
  const auto value = [](double a) { return 1 - a / 8 + 40 * a * a * std::pow(a - 0.1, 2); };
  const auto slope = [](double a) { return -1.0 / 8 + 80 * a * (a - 0.1) * (2 * a - 0.1); };
  Path path(value, slope);
  path.Search();
  ASSERT_GE(path.evaluated.size(), 2u);
  EXPECT_NEAR(slope(path.evaluated[1]), 0, 1e-9);  // phi has degree 4: the second fit is exact
}

TEST(ProjectedLineSearch, ContractsBetweenAThousandthAndSixTenths) {
  Path far([](double a) { return a == 0 ? 0 : a - 1e-9; },
           [](double a) { return a == 0 ? -1e-9 : 1; });
  far.Search();
  EXPECT_NEAR(far.evaluated[0], 1e-3, 0.02);
  Path near([](double a) { return a < 0.9 ? -a : 1.0; },
            [](double a) { return a < 0.9 ? -1 : 1e3; });
  near.Search();
  EXPECT_EQ(near.evaluated[0], 0.6);
}

TEST(ProjectedLineSearch, HalvesAStepWithoutAFiniteCostOrSlope) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  Path pole([&](double a) { return a > 0.3 ? nan : -a; }, [](double) { return -1.0; });
  EXPECT_EQ(pole.Search().step_norm, 0.25);
  EXPECT_EQ(pole.evaluated, (std::vector<double>{0.5, 0.25}));
  Path kink([](double a) { return a > 0.3 ? 1 : -a; },
            [&](double a) { return a > 0.3 ? nan : -1.0; });
  EXPECT_EQ(kink.Search().step_norm, 0.25);
}

TEST(ProjectedLineSearch, GivesUpAfterTwentyValues) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  Path path([&](double a) { return a > 0 ? nan : 0; }, [](double) { return -1.0; }, 1e9);
  const Candidate found = path.Search();
  EXPECT_TRUE(std::isnan(found.cost));
  EXPECT_EQ(found.step_norm, 1);
  ASSERT_EQ(path.evaluated.size(), 20u);  // the whole step came before, and comes again
  EXPECT_EQ(path.evaluated[18], std::pow(0.5, 19));
  EXPECT_EQ(path.evaluated[19], 1);
}

TEST(ProjectedLineSearch, GivesUpWhereTheStepVanishes) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  Path path([&](double a) { return a > 0 ? nan : 0; }, [](double) { return -1.0; }, 5e-9);
  path.Search();
  EXPECT_EQ(path.evaluated, (std::vector<double>{0.5, 0.25, 1}));
}

}  // namespace
}  // namespace bundle

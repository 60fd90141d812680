// The minimiser iteration by iteration against ceres::Solve.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <tuple>

#include "core/ceres/summarize.h"
#include "core/minimize/trust_region.h"
#include "minimize/ceres_oracle.h"
#include "minimize/classic_functions.h"
#include "minimize/dense_problem.h"

namespace bundle {
namespace {

/// Differences allowed are rounding errors, after they have grown for some iterations.
void ExpectClose(double ours, double ceres, double absolute, const char* what) {
  EXPECT_NEAR(ours, ceres, 1e-8 * std::abs(ceres) + absolute) << what;
}

/// `scale`: of cost and gradient at the start. What is left of them at the end are rounding errors.
void ExpectSameRecord(const IterationRecord& ours, const IterationRecord& ceres, double scale,
                      bool measures_step) {
  SCOPED_TRACE("iteration " + std::to_string(ceres.iteration));
  EXPECT_EQ(ours.iteration, ceres.iteration);
  EXPECT_EQ(ours.step_is_successful, ceres.step_is_successful);
  EXPECT_EQ(ours.linear_solver_iterations, ceres.linear_solver_iterations);
  // Hilbert's matrix, of condition 5e11, makes most of it; compilers differ.
  const double rounding = 1e-11 * ceres.cost + 1e-20 * scale;
  const double predicted = ceres.cost_change / ceres.relative_decrease;
  const double noise = predicted > 0 ? rounding / predicted : 0;
  ExpectClose(ours.cost, ceres.cost, rounding, "cost");
  ExpectClose(ours.cost_change, ceres.cost_change, rounding, "cost_change");
  ExpectClose(ours.relative_decrease, ceres.relative_decrease, noise, "relative_decrease");
  ExpectClose(ours.trust_region_radius, ceres.trust_region_radius, 0, "trust_region_radius");
  ExpectClose(ours.gradient_max_norm, ceres.gradient_max_norm, 1e-12 * scale, "gradient_max_norm");
  if (measures_step) ExpectClose(ours.step_norm, ceres.step_norm, 1e-12, "step_norm");
}

using Case = std::tuple<ClassicFunction, TrustRegionStrategy>;

class AgainstCeres : public testing::TestWithParam<Case> {};

TEST_P(AgainstCeres, SameIterations) {
  const auto& [function, strategy] = GetParam();
  SolveOptions options;
  options.trust_region_strategy_type = strategy;
  const CeresResult ceres = SolveWithCeres(function, options);
  DenseProblem problem(function);
  const MinimizerSummary minimum = Minimize(options, nullptr, &problem);

  EXPECT_EQ(minimum.termination_type,
            ceres::TerminationTypeToString(ceres.summary.termination_type));
  const auto beginning = [](const std::string& message) { return message.substr(0, 20); };
  EXPECT_EQ(beginning(minimum.message), beginning(ceres.summary.message));
  EXPECT_EQ(minimum.num_successful_steps, ceres.summary.num_successful_steps);
  EXPECT_EQ(minimum.num_unsuccessful_steps, ceres.summary.num_unsuccessful_steps);
  ASSERT_EQ(minimum.iterations.size(), ceres.summary.iterations.size());
  bool measures_step = CERES_VERSION_MAJOR == 2 && CERES_VERSION_MINOR == 1;
  for (size_t k = 0; k < minimum.iterations.size(); ++k) {
    const IterationRecord record = ToRecord(ceres.summary.iterations[k], 0, StepLengths());
    ExpectSameRecord(minimum.iterations[k], record, ceres.summary.initial_cost, measures_step);
    measures_step = measures_step || (k > 0 && record.step_is_successful);
  }
  if (function.lower.empty()) {
    EXPECT_EQ(problem.num_evaluations_along_steps, 0);
  }
  for (size_t k = 0; k < ceres.x.size(); ++k) {
    EXPECT_NEAR(problem.x()[k], ceres.x[k], 1e-6 * std::max(1.0, problem.x().norm()));
  }
}

std::string NameOf(const testing::TestParamInfo<Case>& info) {
  const char* const names[] = {"LevenbergMarquardt", "Dogleg", "SubspaceDogleg"};
  return std::get<0>(info.param).name + names[static_cast<int>(std::get<1>(info.param))];
}

INSTANTIATE_TEST_SUITE_P(Functions, AgainstCeres,
                         testing::Combine(testing::ValuesIn(ClassicFunctions()),
                                          testing::Values(TrustRegionStrategy::kLevenbergMarquardt,
                                                          TrustRegionStrategy::kDogleg,
                                                          TrustRegionStrategy::kSubspaceDogleg)),
                         NameOf);

/// The list has what it is meant to have.
TEST(BoundedFunctions, SearchEndOnBoundsAndWithinThem) {
  int num_that_search = 0, num_on_bounds = 0, num_within = 0;
  for (const ClassicFunction& function : BoundedFunctions()) {
    DenseProblem problem(function);
    Minimize(SolveOptions(), nullptr, &problem);
    bool is_on_bound = false;
    for (size_t k = 0; k < function.lower.size(); ++k) {
      const double x = problem.x()[static_cast<Eigen::Index>(k)];
      EXPECT_LE(function.lower[k], x);
      EXPECT_LE(x, function.upper[k]);
      is_on_bound = is_on_bound || x == function.lower[k] || x == function.upper[k];
    }
    num_that_search += problem.num_evaluations_along_steps > 0;
    ++(is_on_bound ? num_on_bounds : num_within);
  }
  EXPECT_GE(num_that_search, 3);
  EXPECT_GE(num_on_bounds, 5);
  EXPECT_GE(num_within, 2);
}

INSTANTIATE_TEST_SUITE_P(Bounded, AgainstCeres,
                         testing::Combine(testing::ValuesIn(BoundedFunctions()),
                                          testing::Values(TrustRegionStrategy::kLevenbergMarquardt,
                                                          TrustRegionStrategy::kDogleg,
                                                          TrustRegionStrategy::kSubspaceDogleg)),
                         NameOf);

}  // namespace
}  // namespace bundle

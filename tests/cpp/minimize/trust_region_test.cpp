// Every way in which a minimisation ends.

#include "core/minimize/trust_region.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "core/parallel/thread_pool.h"
#include "minimize/ceres_oracle.h"
#include "minimize/classic_functions.h"
#include "minimize/dense_problem.h"
#include "minimize/endless_options.h"

namespace bundle {
namespace {

void ExpectEndsAsCeres(const ClassicFunction& function, const SolveOptions& options,
                       const std::string& message) {
  SCOPED_TRACE(function.name);
  const CeresResult ceres = SolveWithCeres(function, options);
  DenseProblem problem(function);
  const MinimizerSummary minimum = Minimize(options, nullptr, &problem);
  EXPECT_EQ(minimum.termination_type,
            ceres::TerminationTypeToString(ceres.summary.termination_type));
  EXPECT_EQ(minimum.message, ceres.summary.message);
  EXPECT_EQ(minimum.message.rfind(message, 0), 0) << minimum.message;
  EXPECT_FALSE(minimum.interrupted);
  EXPECT_EQ(minimum.num_successful_steps, ceres.summary.num_successful_steps);
  EXPECT_EQ(minimum.num_unsuccessful_steps, ceres.summary.num_unsuccessful_steps);
  EXPECT_EQ(minimum.iterations.size(), ceres.summary.iterations.size());
  for (size_t k = 0; k < ceres.x.size(); ++k) EXPECT_NEAR(problem.x()[k], ceres.x[k], 1e-9);
}

TEST(TrustRegion, StopsAtTheGradientTolerance) {
  for (const TrustRegionStrategy strategy : kStrategies) {
    SolveOptions options = Endless(strategy);
    options.gradient_tolerance = 1e-3;
    ExpectEndsAsCeres(Powell(), options, "Gradient tolerance reached. Gradient max norm: ");
  }
}

TEST(TrustRegion, StopsAtTheFunctionTolerance) {
  for (const TrustRegionStrategy strategy : kStrategies) {
    SolveOptions options = Endless(strategy);
    options.function_tolerance = 0.95;  // a step of Powell's takes 15/16 of the cost
    ExpectEndsAsCeres(Powell(), options, "Function tolerance reached. |cost_change|/cost: ");
  }
}

TEST(TrustRegion, StopsAtTheParameterToleranceOnceAStepHasSucceeded) {
  for (const TrustRegionStrategy strategy : kStrategies) {
    SolveOptions options = Endless(strategy);
    options.parameter_tolerance = 0.9;
    ExpectEndsAsCeres(Powell(), options, "Parameter tolerance reached. Relative step_norm: ");
    DenseProblem problem(Powell());
    EXPECT_EQ(Minimize(options, nullptr, &problem).num_successful_steps, 2);
  }
}

TEST(TrustRegion, StopsAtTheLimitOfIterations) {
  for (const int limit : {0, 1, 7}) {
    SolveOptions options = Endless();
    options.max_num_iterations = limit;
    ExpectEndsAsCeres(Wood(), options, "Maximum number of iterations reached. Number of iter");
  }
}

TEST(TrustRegion, WithoutIterationsOnlyRecordsTheStart) {
  SolveOptions options;
  options.max_num_iterations = 0;
  DenseProblem problem(Beale());
  const MinimizerSummary minimum = Minimize(options, nullptr, &problem);
  ASSERT_EQ(minimum.iterations.size(), 1u);
  const IterationRecord& start = minimum.iterations[0];
  EXPECT_EQ(start.iteration, 0);
  EXPECT_DOUBLE_EQ(start.cost, (1.5 * 1.5 + 2.25 * 2.25 + 2.625 * 2.625) / 2);
  EXPECT_TRUE(start.step_is_successful);
  EXPECT_EQ(start.trust_region_radius, 1e4);
  EXPECT_EQ(start.step_norm, 0);
  EXPECT_EQ(minimum.num_linear_solves, 0);
  EXPECT_EQ(minimum.num_candidates, 0);
  EXPECT_EQ(minimum.num_linearizations, 1);
}

TEST(TrustRegion, ShrinksToNothingWhereNoStepIsFinite) {
  const ClassicFunction pole{"pole", {0}, 1, [](const auto& x, auto* r, auto* j) {
                               *r << (x[0] == 0 ? 1 : std::numeric_limits<double>::quiet_NaN());
                               *j << 1;
                             }};
  for (const TrustRegionStrategy strategy : kStrategies) {
    SolveOptions options = Endless(strategy);
    options.max_num_iterations = 1000;
    ExpectEndsAsCeres(pole, options, "Minimum trust region radius reached. Trust region radius: ");
  }
}

TEST(TrustRegion, GivesUpAfterTenInvalidSteps) {
  // A gradient of 1e-170 is above zero, and what it promises is not.
  const ClassicFunction flat{"flat", {0}, 1, [](const auto& x, auto* r, auto* j) {
                               *r << 1 + 1e-170 * x[0];
                               *j << 1e-170;
                             }};
  for (const TrustRegionStrategy strategy : kStrategies) {
    ExpectEndsAsCeres(flat, Endless(strategy),
                      "Number of consecutive invalid steps more than Solver::Options::");
  }
}

TEST(TrustRegion, FailsWhereTheStartIsNotFinite) {
  ClassicFunction function = NanInPlaces();
  function.start = {-1, 1};
  DenseProblem problem(function);
  const MinimizerSummary minimum = Minimize(SolveOptions(), nullptr, &problem);
  EXPECT_EQ(minimum.termination_type, "FAILURE");
  EXPECT_EQ(minimum.message, "Initial residual and Jacobian evaluation failed.");
  EXPECT_TRUE(minimum.iterations.empty());
  EXPECT_EQ(minimum.num_successful_steps, 0);
}

TEST(TrustRegion, GoesBackWhereTheJacobianCeasesToBeFinite) {
  ClassicFunction function = Beale();
  function.evaluate = [inner = function.evaluate](const auto& x, auto* r, auto* j) {
    inner(x, r, j);
    if (x[1] < 0.5) (*j)(0, 0) = std::numeric_limits<double>::infinity();
  };
  ExpectEndsAsCeres(function, SolveOptions(), "Residual and Jacobian evaluation failed.");
  DenseProblem problem(function);
  Minimize(SolveOptions(), nullptr, &problem);
  EXPECT_EQ(problem.x(), Eigen::VectorXd::Ones(2));
}

TEST(TrustRegion, RecordsACandidateThatIsNotFiniteAsCeresDoes) {
  DenseProblem problem(NanInPlaces());
  const MinimizerSummary minimum = Minimize(SolveOptions(), nullptr, &problem);
  ASSERT_GT(minimum.iterations.size(), 2u);
  const IterationRecord& rejected = minimum.iterations[1];
  EXPECT_FALSE(rejected.step_is_successful);
  EXPECT_EQ(rejected.cost, std::numeric_limits<double>::max());
  EXPECT_EQ(rejected.relative_decrease, std::numeric_limits<double>::lowest());
  EXPECT_EQ(rejected.gradient_max_norm, minimum.iterations[0].gradient_max_norm);
}

TEST(TrustRegion, ObeysTheProgressCallback) {
  for (const int last : {0, 3}) {
    std::vector<IterationRecord> seen;
    const ProgressCallback progress = [&](const IterationRecord& record) {
      seen.push_back(record);
      return record.iteration != last;
    };
    DenseProblem problem(Wood()), reference(Wood());
    const MinimizerSummary minimum = Minimize(Endless(), progress, &problem);
    EXPECT_TRUE(minimum.interrupted);
    EXPECT_EQ(minimum.termination_type, "USER_SUCCESS");
    EXPECT_EQ(minimum.message, "User callback returned SOLVER_TERMINATE_SUCCESSFULLY.");
    ASSERT_EQ(seen.size(), last + 1u);
    EXPECT_EQ(minimum.iterations.size(), seen.size());
    EXPECT_EQ(minimum.iterations.back().cost, seen.back().cost);
    SolveOptions options = Endless();
    options.max_num_iterations = last;
    Minimize(options, nullptr, &reference);
    EXPECT_EQ(problem.x(), reference.x());
  }
}

/// Throws Interrupted in one of its passes.
class InterruptedProblem final : public LeastSquares {
 public:
  InterruptedProblem(LeastSquares* problem, int linearization, int newton)
      : problem_(problem), linearization_(linearization), newton_(newton) {}

  Linearization Linearize(double damping) override {
    if (--linearization_ == 0) throw Interrupted();
    return problem_->Linearize(damping);
  }
  NewtonResult SolveNewton(double eta) override {
    if (--newton_ == 0) throw Interrupted();
    return problem_->SolveNewton(eta);
  }
  Candidate EvaluateNewtonStep() override { return problem_->EvaluateNewtonStep(); }
  DoglegProducts Products() override { return problem_->Products(); }
  Candidate EvaluateDoglegStep(double a, double b) override {
    return problem_->EvaluateDoglegStep(a, b);
  }
  void Accept() override { problem_->Accept(); }
  double StateNorm() const override { return problem_->StateNorm(); }

 private:
  LeastSquares* problem_;
  int linearization_, newton_;
};

TEST(TrustRegion, KeepsTheBestStateWhereItIsInterruptedWithinAStep) {
  for (const TrustRegionStrategy strategy : kStrategies) {
    SolveOptions options = Endless(strategy);
    options.max_num_iterations = 3;
    DenseProblem whole(Powell());
    const MinimizerSummary expected = Minimize(options, nullptr, &whole);
    ASSERT_EQ(expected.num_successful_steps, 4);

    DenseProblem in_solve(Powell());
    InterruptedProblem first(&in_solve, 0, 4);
    options.max_num_iterations = 100;
    int num_reported = 0;
    const auto count = [&](const IterationRecord&) { return ++num_reported > 0; };
    const MinimizerSummary left = Minimize(options, count, &first);
    EXPECT_EQ(left.termination_type, "USER_SUCCESS");
    EXPECT_TRUE(left.interrupted);
    EXPECT_EQ(left.iterations.size(), 4u);
    EXPECT_EQ(num_reported, 4);
    EXPECT_EQ(left.iterations.back().cost, expected.iterations.back().cost);
    EXPECT_EQ(in_solve.x(), whole.x());
    if (strategy != TrustRegionStrategy::kLevenbergMarquardt) continue;

    // The step is taken when its linearisation is left.
    DenseProblem in_pass(Powell());
    InterruptedProblem second(&in_pass, 4, 0);
    num_reported = 0;
    const MinimizerSummary taken = Minimize(options, count, &second);
    EXPECT_EQ(taken.termination_type, "USER_SUCCESS");
    EXPECT_TRUE(taken.interrupted);
    EXPECT_EQ(taken.num_successful_steps, 4);
    EXPECT_EQ(num_reported, 4);
    EXPECT_TRUE(taken.iterations.back().step_is_successful);
    EXPECT_NEAR(taken.iterations.back().cost, expected.iterations.back().cost,
                1e-12 * expected.iterations.back().cost);
    EXPECT_EQ(in_pass.x(), whole.x());
  }
}

TEST(TrustRegion, HasNothingToKeepBeforeTheFirstLinearization) {
  DenseProblem problem(Powell());
  InterruptedProblem interrupted(&problem, 1, 0);
  EXPECT_THROW(Minimize(Endless(), nullptr, &interrupted), Interrupted);
}

}  // namespace
}  // namespace bundle

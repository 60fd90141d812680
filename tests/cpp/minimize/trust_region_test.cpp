// Every way in which a minimisation ends, and what a strategy asks of the problem.

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

namespace bundle {
namespace {

constexpr TrustRegionStrategy kStrategies[] = {TrustRegionStrategy::kLevenbergMarquardt,
                                               TrustRegionStrategy::kDogleg,
                                               TrustRegionStrategy::kSubspaceDogleg};

/// Options under which only the limit of iterations ends a solve.
SolveOptions Endless(TrustRegionStrategy strategy = TrustRegionStrategy::kLevenbergMarquardt) {
  SolveOptions options;
  options.trust_region_strategy_type = strategy;
  options.function_tolerance = 0;
  options.gradient_tolerance = 0;
  options.parameter_tolerance = 0;
  return options;
}

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

/// A problem whose linear solver has some bad days, and that remembers what it was asked.
class Unreliable final : public LeastSquares {
 public:
  Unreliable(ClassicFunction function, std::vector<NewtonResult> results)
      : problem_(std::move(function)), results_(std::move(results)) {}

  Linearization Linearize(double damping) override {
    dampings.push_back(damping);
    return problem_.Linearize(damping);
  }
  NewtonResult SolveNewton(double eta) override {
    etas.push_back(eta);
    if (etas.size() <= results_.size()) return results_[etas.size() - 1];
    return problem_.SolveNewton(eta);
  }
  Candidate EvaluateNewtonStep() override { return problem_.EvaluateNewtonStep(); }
  DoglegProducts Products() override { return problem_.Products(); }
  Candidate EvaluateDoglegStep(double a, double b) override {
    return problem_.EvaluateDoglegStep(a, b);
  }
  void Accept() override { problem_.Accept(); }
  double StateNorm() const override { return problem_.StateNorm(); }

  std::vector<double> dampings, etas;

 private:
  DenseProblem problem_;
  const std::vector<NewtonResult> results_;
};

/// A problem whose costs are a little off, and that says so.
class Uncertain final : public LeastSquares {
 public:
  Uncertain(ClassicFunction function, double off, double uncertainty)
      : problem_(std::move(function)), off_(off), uncertainty_(uncertainty) {}

  Linearization Linearize(double damping) override { return problem_.Linearize(damping); }
  NewtonResult SolveNewton(double eta) override { return problem_.SolveNewton(eta); }
  Candidate EvaluateNewtonStep() override {
    Candidate candidate = problem_.EvaluateNewtonStep();
    candidate.cost *= 1 + off_;
    candidate.cost_uncertainty = uncertainty_;
    return candidate;
  }
  DoglegProducts Products() override { return problem_.Products(); }
  Candidate EvaluateDoglegStep(double a, double b) override {
    return problem_.EvaluateDoglegStep(a, b);
  }
  void Accept() override { problem_.Accept(); }
  double StateNorm() const override { return problem_.StateNorm(); }

 private:
  DenseProblem problem_;
  const double off_, uncertainty_;
};

std::vector<double> RadiiOf(double off, double uncertainty) {
  Uncertain problem(Rosenbrock(), off, uncertainty);
  SolveOptions options = Endless();
  options.max_num_iterations = 6;
  std::vector<double> radii;
  for (const IterationRecord& record : Minimize(options, nullptr, &problem).iterations) {
    radii.push_back(record.trust_region_radius);
  }
  return radii;
}

TEST(TrustRegion, RadiiFollowFromTheCertainDigitsOfTheQuality) {
  EXPECT_NE(RadiiOf(0, 0), RadiiOf(1e-13, 0));
  EXPECT_EQ(RadiiOf(0, 1e-6), RadiiOf(1e-13, 1e-6));
  const std::vector<double> exact = RadiiOf(0, 0), certain = RadiiOf(0, 1e-6);
  ASSERT_EQ(exact.size(), certain.size());
  for (size_t k = 0; k < exact.size(); ++k) EXPECT_NEAR(certain[k] / exact[k], 1, 1e-3);
}

TEST(TrustRegion, AQualityKeepsAnEighthHoweverUncertainItIs) {
  Uncertain problem(Rosenbrock(), 0, 1e300);
  SolveOptions options = Endless();
  options.max_num_iterations = 6;
  const MinimizerSummary minimum = Minimize(options, nullptr, &problem);
  for (size_t k = 1; k < minimum.iterations.size(); ++k) {
    const IterationRecord& record = minimum.iterations[k];
    if (!record.step_is_successful) continue;
    const double quality = std::round(8 * record.relative_decrease) / 8;
    const double shrink = std::max(1.0 / 3, 1 - std::pow(2 * quality - 1, 3));
    EXPECT_DOUBLE_EQ(record.trust_region_radius,
                     minimum.iterations[k - 1].trust_region_radius / shrink);
  }
}

const NewtonResult kIndefinite{LinearStatus::kFailure, 1, "not positive definite"};

TEST(TrustRegion, LevenbergMarquardtDampsMoreAfterAFailure) {
  Unreliable problem(Hilbert(), {kIndefinite, kIndefinite, kIndefinite});
  SolveOptions options = Endless();
  options.max_num_iterations = 4;
  const MinimizerSummary minimum = Minimize(options, nullptr, &problem);
  ASSERT_EQ(minimum.iterations.size(), 5u);
  for (const int k : {1, 2, 3}) {
    const IterationRecord& failed = minimum.iterations[k];
    EXPECT_FALSE(failed.step_is_successful);
    EXPECT_EQ(failed.cost, minimum.iterations[0].cost);
    EXPECT_EQ(failed.cost_change, 0);
    EXPECT_EQ(failed.gradient_max_norm, minimum.iterations[0].gradient_max_norm);
    EXPECT_EQ(failed.linear_solver_iterations, 1);
    EXPECT_DOUBLE_EQ(failed.trust_region_radius, 1e4 / (2 << (k * (k + 1) / 2 - 1)));
  }
  EXPECT_TRUE(minimum.iterations[4].step_is_successful);
  EXPECT_EQ(problem.etas, std::vector<double>(4, 0.1));
  ASSERT_EQ(problem.dampings.size(), 5u);
  for (size_t k = 0; k < 5; ++k) {
    const size_t of_radius = k == 0 ? 0 : k;
    EXPECT_DOUBLE_EQ(problem.dampings[k], 1 / minimum.iterations[of_radius].trust_region_radius);
  }
  EXPECT_EQ(minimum.num_linearizations, 5);
  EXPECT_EQ(minimum.num_linear_solves, 4);
  EXPECT_EQ(minimum.num_candidates, 1);
}

TEST(TrustRegion, DoglegsDampMoreWithinAnIteration) {
  for (const TrustRegionStrategy strategy : {kStrategies[1], kStrategies[2]}) {
    Unreliable problem(Hilbert(), {kIndefinite, kIndefinite, kIndefinite});
    SolveOptions options = Endless(strategy);
    options.max_num_iterations = 2;
    const MinimizerSummary minimum = Minimize(options, nullptr, &problem);
    EXPECT_EQ(minimum.num_successful_steps, 3);
    const std::vector<double> expected = {1e-8, 1e-7, 1e-6, 1e-5, 2e-6, 4e-7};
    ASSERT_EQ(problem.dampings.size(), expected.size());
    for (size_t k = 0; k < expected.size(); ++k) {
      EXPECT_DOUBLE_EQ(problem.dampings[k], expected[k]);
    }
    EXPECT_EQ(problem.etas, std::vector<double>(5, 0.0));
  }
}

TEST(TrustRegion, DoglegsGiveUpWhereNoDampingHelps) {
  Unreliable problem(Hilbert(), std::vector<NewtonResult>(100, kIndefinite));
  const MinimizerSummary minimum =
      Minimize(Endless(TrustRegionStrategy::kDogleg), nullptr, &problem);
  EXPECT_EQ(minimum.termination_type, "FAILURE");
  ASSERT_EQ(minimum.iterations.size(), 10u);
  EXPECT_EQ(minimum.iterations[1].linear_solver_iterations, 1);
  EXPECT_EQ(minimum.iterations[2].linear_solver_iterations, -1);  // nothing left to try
  EXPECT_EQ(minimum.num_linear_solves, 8);                        // 1e-8 to 1e-1
  EXPECT_EQ(minimum.num_candidates, 0);
}

TEST(TrustRegion, DoglegsReuseTheirDirectionsAfterARejectedStep) {
  for (const TrustRegionStrategy strategy : {kStrategies[1], kStrategies[2]}) {
    DenseProblem problem(NanInPlaces());
    SolveOptions options = Endless(strategy);
    options.max_num_iterations = 15;
    const MinimizerSummary minimum = Minimize(options, nullptr, &problem);
    EXPECT_GT(minimum.num_unsuccessful_steps, 0);
    int num_solves = 0;
    for (const IterationRecord& record : minimum.iterations) {
      num_solves += record.linear_solver_iterations;
    }
    EXPECT_EQ(minimum.num_linear_solves, num_solves);
    EXPECT_LT(num_solves, minimum.num_candidates);
    EXPECT_EQ(minimum.num_linearizations, minimum.num_successful_steps);
  }
}

TEST(TrustRegion, GivesUpAtOnceWhereNothingHelps) {
  for (const TrustRegionStrategy strategy : kStrategies) {
    Unreliable problem(Wood(), {{LinearStatus::kFatal, 0, "no memory"}});
    const MinimizerSummary minimum = Minimize(Endless(strategy), nullptr, &problem);
    EXPECT_EQ(minimum.termination_type, "FAILURE");
    EXPECT_EQ(minimum.message,
              "Linear solver failed due to unrecoverable non-numeric causes. no memory");
    EXPECT_EQ(minimum.iterations.size(), 1u);
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

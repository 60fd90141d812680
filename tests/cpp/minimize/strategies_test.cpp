// Requests of a strategy to the problem, and the radii that follow.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "core/minimize/trust_region.h"
#include "minimize/classic_functions.h"
#include "minimize/dense_problem.h"
#include "minimize/endless_options.h"

namespace bundle {
namespace {

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

}  // namespace
}  // namespace bundle

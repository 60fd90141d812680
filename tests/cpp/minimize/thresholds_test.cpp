// Where the minimiser and its strategies draw their lines, with steps of any quality.

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "core/minimize/trust_region.h"

namespace bundle {
namespace {

/// A cost of 1000 and candidates as the script has them: each promises 1 and keeps `quality` of it,
/// at the length of the Newton direction. NaN: promises nothing.
class Scripted final : public LeastSquares {
 public:
  explicit Scripted(std::vector<double> qualities) : qualities_(std::move(qualities)) {}

  Linearization Linearize(double damping) override {
    dampings.push_back(damping);
    return {true, cost_, 0, 1, 1};
  }
  NewtonResult SolveNewton(double /*eta*/) override { return {}; }
  Candidate EvaluateNewtonStep() override { return Next(1); }
  DoglegProducts Products() override {
    return {kLength * kLength, -kLength * kLength, kLength * kLength, 1, -1, 1};
  }
  Candidate EvaluateDoglegStep(double /*a*/, double b) override { return Next(b); }
  void Accept() override { std::swap(cost_, candidate_cost_); }
  double StateNorm() const override { return 1e9; }

  static constexpr double kLength = 100;
  std::vector<double> dampings;

 private:
  Candidate Next(double share) {
    const double quality = qualities_[num_candidates_++ % qualities_.size()];
    candidate_cost_ = cost_ - quality;
    if (std::isnan(quality)) return {0, share * kLength, cost_};
    return {1, share * kLength, candidate_cost_};
  }

  const std::vector<double> qualities_;
  size_t num_candidates_ = 0;
  double cost_ = 1000, candidate_cost_ = 0;
};

constexpr double kInvalid = std::numeric_limits<double>::quiet_NaN();

/// One iteration a quality.
MinimizerSummary Play(const std::vector<double>& qualities, TrustRegionStrategy strategy,
                      std::vector<double>* dampings = nullptr) {
  SolveOptions options;
  options.trust_region_strategy_type = strategy;
  options.max_num_iterations = static_cast<int>(qualities.size());
  options.function_tolerance = 0;
  options.gradient_tolerance = 0;
  options.parameter_tolerance = 0;
  Scripted problem(qualities);
  MinimizerSummary minimum = Minimize(options, nullptr, &problem);
  if (dampings != nullptr) *dampings = problem.dampings;
  return minimum;
}

std::vector<double> Radii(const MinimizerSummary& minimum) {
  std::vector<double> radii;
  for (const IterationRecord& record : minimum.iterations) {
    radii.push_back(record.trust_region_radius);
  }
  return radii;
}

void ExpectNear(const std::vector<double>& values, const std::vector<double>& expected) {
  ASSERT_EQ(values.size(), expected.size());
  for (size_t k = 0; k < values.size(); ++k)
    EXPECT_NEAR(values[k], expected[k], 1e-9 * expected[k]);
}

constexpr TrustRegionStrategy kLm = TrustRegionStrategy::kLevenbergMarquardt;
constexpr TrustRegionStrategy kDogleg = TrustRegionStrategy::kDogleg;

TEST(Thresholds, AThousandthOfWhatWasPromisedIsEnough) {
  const MinimizerSummary minimum = Play({0.9e-3, 1.1e-3, -1, 3}, kLm);
  const bool expected[] = {true, false, true, false, true};
  ASSERT_EQ(minimum.iterations.size(), 5u);
  for (int k = 0; k < 5; ++k) EXPECT_EQ(minimum.iterations[k].step_is_successful, expected[k]);
  EXPECT_EQ(minimum.num_successful_steps, 3);
  EXPECT_EQ(minimum.num_unsuccessful_steps, 2);
}

TEST(Thresholds, TheRadiusOfLevenbergMarquardtFollowsTheQuality) {
  ExpectNear(Radii(Play({1, 0.5, 0.25, 0.75, 0.9}, kLm)),
             {1e4, 3e4, 3e4, 3e4 / 1.125, 3e4 / 1.125 / 0.875, 3e4 / 1.125 / 0.875 / 0.488});
  ExpectNear(Radii(Play({-1, -1, -1, 0.5, -1}, kLm)),
             {1e4, 1e4 / 2, 1e4 / 8, 1e4 / 64, 1e4 / 64, 1e4 / 128});
  EXPECT_EQ(Radii(Play(std::vector<double>(40, 1), kLm)).back(), 1e16);
}

TEST(Thresholds, TheRadiusOfADoglegFollowsTheQuality) {
  ExpectNear(Radii(Play({0.24, 0.26, 0.74, 1, -1, -1}, kDogleg)),
             {1e4, 5e3, 5e3, 5e3, 5e3, 2.5e3, 1.25e3});
  // Down to 78.125, where steps end at the radius, and back.
  std::vector<double> qualities(7, -1);
  qualities.insert(qualities.end(), {0.76, 0.76, 0.76});
  ExpectNear(Radii(Play(qualities, kDogleg)),
             {1e4, 5e3, 2.5e3, 1250, 625, 312.5, 156.25, 78.125, 3 * 78.125, 300, 300});
}

TEST(Thresholds, InvalidStepsCountInARow) {
  std::vector<double> qualities(9, kInvalid);
  qualities.push_back(1);
  qualities.insert(qualities.end(), 9, kInvalid);
  const MinimizerSummary patient = Play(qualities, kLm);
  EXPECT_EQ(patient.termination_type, "NO_CONVERGENCE");
  EXPECT_EQ(patient.num_unsuccessful_steps, 18);
  const MinimizerSummary lost = Play(std::vector<double>(20, kInvalid), kLm);
  EXPECT_EQ(lost.termination_type, "FAILURE");
  EXPECT_EQ(lost.num_unsuccessful_steps, 9);
}

TEST(Thresholds, InvalidStepsOfADoglegAreDamped) {
  std::vector<double> dampings;
  const MinimizerSummary minimum = Play({kInvalid, kInvalid, 0.5, 0.5}, kDogleg, &dampings);
  ExpectNear(dampings, {1e-8, 1e-7, 1e-6, 2e-7, 4e-8});
  EXPECT_EQ(minimum.num_linear_solves, 4);
  ExpectNear(Radii(minimum), std::vector<double>(5, 1e4));
}

TEST(Thresholds, OneReasonComesBeforeAnother) {
  SolveOptions options;
  options.max_num_iterations = 1;
  options.gradient_tolerance = 2;
  Scripted converged({1});
  EXPECT_EQ(Minimize(options, nullptr, &converged).message.rfind("Gradient tolerance", 0), 0u);
  options.max_num_iterations = 0;
  Scripted limited({1});
  EXPECT_EQ(Minimize(options, nullptr, &limited).message.rfind("Maximum number of", 0), 0u);
  options = SolveOptions();
  options.parameter_tolerance = options.function_tolerance = 0.01;
  Scripted both({11, 1});
  EXPECT_EQ(Minimize(options, nullptr, &both).message.rfind("Parameter tolerance", 0), 0u);
}

}  // namespace
}  // namespace bundle

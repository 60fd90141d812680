// The ends of solves in standard deviations, on both sides of each threshold.

#include "core/minimize/sigma_rule.h"

#include <gtest/gtest.h>

#include <cmath>
#include <initializer_list>
#include <limits>
#include <vector>

namespace bundle {
namespace {

constexpr double kDof = 800;
constexpr double kCost = 100;  // sigma is 0.5
constexpr double kSigma = 0.5;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// The decrease of a step of this many sigmas.
double DecreaseOf(double sigmas) { return 0.5 * sigmas * sigmas * kSigma * kSigma; }

/// True if the last of these steps may end the solve.
bool MayEndWith(std::initializer_list<double> sigmas, bool meets = true) {
  SigmaRule rule(kDof);
  bool may_end = false;
  for (const double step : sigmas) may_end = rule.MayEnd(DecreaseOf(step), kCost, meets);
  return may_end;
}

/// A rule after a step that may end, of 0.05 sigmas.
SigmaRule AtEnd() {
  SigmaRule rule(kDof);
  rule.MayEnd(DecreaseOf(0.2), kCost, true);
  EXPECT_TRUE(rule.MayEnd(DecreaseOf(0.05), kCost, true));
  return rule;
}

NewtonDecrement CamerasAre(double sigmas) { return {2 * sigmas * kSigma, sigmas * kSigma}; }

TEST(SigmaRule, TheSigmaIsThatOfTheResiduals) {
  EXPECT_DOUBLE_EQ(SigmaRule(kDof).Sigma(kCost), kSigma);
  EXPECT_TRUE(std::isnan(SigmaRule(0).Sigma(kCost)));
  EXPECT_TRUE(std::isnan(SigmaRule(-3).Sigma(kCost)));
  EXPECT_TRUE(std::isnan(SigmaRule(2).Sigma(0.99e-14)));  // below 1e-7 pixels
  EXPECT_FALSE(std::isnan(SigmaRule(2).Sigma(1.01e-14)));
}

TEST(SigmaRule, AStepBelowATenthOfASigmaIsNear) {
  EXPECT_TRUE(MayEndWith({10, 0.099}));
  EXPECT_FALSE(MayEndWith({10, 0.101}));
  EXPECT_FALSE(MayEndWith({10, 0.099}, false));
}

TEST(SigmaRule, TheRestOfALinearConvergenceIsNear) {
  // q = 1/2: as far again.
  EXPECT_TRUE(MayEndWith({0.099 * std::sqrt(2), 0.099}));
  // q = 0.8: twice as far again.
  EXPECT_TRUE(MayEndWith({0.049 / std::sqrt(0.8), 0.049}));
  EXPECT_FALSE(MayEndWith({0.051 / std::sqrt(0.8), 0.051}));
}

TEST(SigmaRule, ConvergenceIsNeverSlowerThan98Percent) {
  const double longest = 0.1 / std::sqrt(0.98 / 0.02);
  EXPECT_TRUE(MayEndWith({0.99 * longest, 0.99 * longest}));
  EXPECT_FALSE(MayEndWith({1.01 * longest, 1.01 * longest}));
  // Without a step before.
  EXPECT_TRUE(MayEndWith({0.99 * longest}));
  EXPECT_FALSE(MayEndWith({1.01 * longest}));
}

TEST(SigmaRule, AStepThatIsNoDecreaseIsNotNear) {
  SigmaRule rule(kDof);
  EXPECT_FALSE(rule.MayEnd(kNaN, kCost, true));
  // Nor does the next step know how fast the convergence is.
  EXPECT_FALSE(rule.MayEnd(DecreaseOf(0.02), kCost, true));
}

TEST(SigmaRule, WithoutASigmaTheFunctionToleranceEnds) {
  for (const double dof : {0.0, -5.0}) {
    SigmaRule rule(dof);
    EXPECT_FALSE(rule.MayEnd(1e9, kCost, false));
    EXPECT_TRUE(rule.MayEnd(1e9, kCost, true));
    EXPECT_TRUE(rule.Ends({}, kCost));
  }
  SigmaRule exact(kDof);
  EXPECT_TRUE(exact.MayEnd(1e-12, 1e-13, true));
  EXPECT_TRUE(exact.Ends({}, 1e-13));
}

TEST(SigmaRule, CamerasFartherThanThreeTenthsGoOn) {
  EXPECT_TRUE(AtEnd().Ends(CamerasAre(0.299), kCost));
  EXPECT_FALSE(AtEnd().Ends(CamerasAre(0.301), kCost));
  EXPECT_TRUE(AtEnd().Ends({}, kCost));  // not known
}

TEST(SigmaRule, StepsBecomeShorterAsTheDistanceHasTo) {
  SigmaRule rule = AtEnd();
  EXPECT_FALSE(rule.Ends(CamerasAre(1.5), kCost));
  // A fifth of 0.05.
  EXPECT_FALSE(rule.MayEnd(DecreaseOf(0.0102), kCost, true));
  SigmaRule other = AtEnd();
  EXPECT_FALSE(other.Ends(CamerasAre(1.5), kCost));
  EXPECT_TRUE(other.MayEnd(DecreaseOf(0.0098), kCost, true));
}

TEST(SigmaRule, ADistanceThatDoesNotFallEnds) {
  for (const double next : {0.74, 0.76}) {
    SigmaRule rule = AtEnd();
    EXPECT_FALSE(rule.Ends(CamerasAre(1.5), kCost));
    EXPECT_TRUE(rule.MayEnd(DecreaseOf(0.001), kCost, true));
    EXPECT_EQ(rule.Ends(CamerasAre(next), kCost), next > 0.75);
  }
}

/// The numbers of the slow steps at which the rule looks at the cameras, which are this far.
std::vector<int> Looks(double cameras, int steps) {
  SigmaRule rule(kDof);
  std::vector<int> looks;
  for (int k = 1; k <= steps; ++k) {
    if (!rule.MayEnd(DecreaseOf(0.2), kCost, true)) continue;
    looks.push_back(k);
    if (rule.Ends(CamerasAre(cameras), kCost)) break;
  }
  return looks;
}

TEST(SigmaRule, PointsMaySlideForTenSteps) {
  EXPECT_EQ(Looks(0.099, 100), (std::vector<int>{10}));
  EXPECT_EQ(Looks(0.101, 100), (std::vector<int>{10, 20}));
}

}  // namespace
}  // namespace bundle

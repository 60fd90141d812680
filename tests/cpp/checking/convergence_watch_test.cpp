#include "core/checking/convergence_watch.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

namespace bundle {
namespace {

/// Steps whose radius falls to `ratio` of itself each time, and the predicted decrease with it, at
/// a quality of `q` and a constant gradient.
std::vector<IterationRecord> Ladder(int num_steps, double ratio, double q, bool accepted) {
  std::vector<IterationRecord> iterations(1 + num_steps);
  for (int k = 0; k <= num_steps; ++k) {
    IterationRecord& record = iterations[k];
    record.iteration = k;
    record.cost = 1e3;
    record.gradient_max_norm = 1;
    record.trust_region_radius = std::pow(ratio, k);
    record.step_is_successful = k == 0 || accepted;
    if (k == 0) continue;
    const double predicted = std::pow(ratio, k - 1);
    record.cost_change = q * predicted;
    record.relative_decrease = q;
    record.step_norm = predicted;
  }
  return iterations;
}

/// Steps whose error, gradient and length fall to `rate` of themselves each time.
std::vector<IterationRecord> Tail(int num_steps, double rate, double q) {
  std::vector<IterationRecord> iterations(1 + num_steps);
  for (int k = 0; k <= num_steps; ++k) {
    IterationRecord& record = iterations[k];
    record.iteration = k;
    record.cost = 1e3;
    record.gradient_max_norm = std::pow(rate, k);
    record.trust_region_radius = 1e4 * std::pow(0.99, k);
    record.step_is_successful = true;
    if (k == 0) continue;
    record.cost_change = q * std::pow(rate, 2 * (k - 1));
    record.relative_decrease = q;
    record.step_norm = std::pow(rate, k - 1);
  }
  return iterations;
}

bool IsSuspected(const std::vector<IterationRecord>& iterations) {
  return !WatchConvergence(iterations).empty();
}

/// The model of a step does not know of observations that it makes count.
TEST(WatchConvergence, AStepThatChangesWhatCountsEndsALadder) {
  std::vector<IterationRecord> iterations = Ladder(4, 1.0 / 8, -0.4, false);
  EXPECT_TRUE(IsSuspected(iterations));
  iterations[2].changes_what_counts = true;
  EXPECT_FALSE(IsSuspected(iterations));
}

/// However much less there was to gain at the end.
TEST(WatchConvergence, AcceptedStepsAreALadderFromSixRungsOn) {
  EXPECT_TRUE(IsSuspected(Ladder(6, 0.2, 0.05, true)));
  EXPECT_FALSE(IsSuspected(Ladder(5, 0.2, 0.05, true)));
}

TEST(WatchConvergence, ARungIsAtAMuchSmallerRadius) {
  EXPECT_TRUE(IsSuspected(Ladder(60, 0.75, 0.05, true)));
  EXPECT_FALSE(IsSuspected(Ladder(60, 0.85, 0.05, true)));
}

/// True derivatives reach q = 1 - l, and come close to it.
TEST(WatchConvergence, AQuickTailKeepsAMarginToTheTruth) {
  EXPECT_TRUE(IsSuspected(Tail(12, 0.6, 0.55)));
  EXPECT_FALSE(IsSuspected(Tail(12, 0.6, 0.45)));
}

TEST(WatchConvergence, ASlowTailIsThatOfStepsThatDoHalfAsWellAsPromised) {
  EXPECT_TRUE(IsSuspected(Tail(12, 0.78, 0.45)));
  EXPECT_FALSE(IsSuspected(Tail(12, 0.78, 0.55)));
}

}  // namespace
}  // namespace bundle

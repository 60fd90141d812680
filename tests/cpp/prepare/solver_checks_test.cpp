#include <gtest/gtest.h>

#include <cstdint>
#include <limits>
#include <string>

#include "core/error.h"
#include "core/prepare/memory.h"
#include "core/prepare/prepare.h"

namespace bundle {
namespace {

TEST(SolverChecks, RefuseAFactorBeyondMemoryWithItsSize) {
  EXPECT_NO_THROW(RefuseTooMuchMemory(LinearSolverType::kSparseSchur, 1e3));
  try {
    RefuseTooMuchMemory(LinearSolverType::kSparseSchur, 1e17);
    FAIL() << "not refused";
  } catch (const InputError& error) {
    const std::string message = error.what();
    EXPECT_EQ(message.rfind("linear_solver_type: SPARSE_SCHUR needs 100 PB for its factor; ", 0), 0)
        << message;
    EXPECT_NE(message.find(" free; use iterative_schur"), std::string::npos) << message;
  }
}

TEST(SolverChecks, RefuseWorkBeyondMemory) {
  EXPECT_NO_THROW(RefuseTooMuchMemory(1e3));
  EXPECT_THROW(RefuseTooMuchMemory(1e17), InputError);
  EXPECT_NO_THROW(RefuseTooMuchMemory(LinearSolverType::kSparseSchur, 1e3, 1e3));
  EXPECT_THROW(RefuseTooMuchMemory(LinearSolverType::kSparseSchur, 1e3, 1e17), InputError);
}

TEST(SolverChecks, LeaveATenthOfTheMemory) {
  EXPECT_TRUE(FitsIntoMemory(0.89e9, 1e9));
  EXPECT_FALSE(FitsIntoMemory(0.91e9, 1e9));
}

/// A problem of these sizes; nobody looks into it.
AdjustmentProblem Sizes(int num_images, int num_points, int64_t num_observations) {
  AdjustmentProblem problem;
  problem.num_images = num_images;
  problem.num_points = num_points;
  problem.num_observations = num_observations;
  return problem;
}

TEST(SolverChecks, RefuseMoreResidualsAndParametersThanAnIntCounts) {
  constexpr int kMost = std::numeric_limits<int>::max();
  EXPECT_NO_THROW(RefuseTooLarge(Sizes(0, kMost / 3, kMost / 2)));
  EXPECT_NO_THROW(RefuseTooLarge(Sizes(1'000'000, 600'000'000, 1'000'000'000)));
  EXPECT_THROW(RefuseTooLarge(Sizes(0, 0, kMost / 2 + 1)), InputError);
  EXPECT_THROW(RefuseTooLarge(Sizes(0, kMost / 3 + 1, 0)), InputError);
  EXPECT_THROW(RefuseTooLarge(Sizes(1, kMost / 3, 0)), InputError);
  EXPECT_THROW(RefuseTooLarge(Sizes(kMost, 0, 0)), InputError);
  try {
    RefuseTooLarge(Sizes(0, kMost, 0));
    FAIL() << "not refused";
  } catch (const InputError& error) {
    EXPECT_STREQ(error.what(), "points: expected at most 715827882 in one solve, found 2147483647");
  }
}

}  // namespace
}  // namespace bundle

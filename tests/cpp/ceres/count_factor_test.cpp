#include <gtest/gtest.h>

#include "core/ceres/summarize.h"
#include "core/prepare/prepare.h"
#include "support/scene.h"

namespace bundle {
namespace {

FactorSummary Count(bool refine_points, ceres::LinearSolverType type) {
  const testing::Scene scene = testing::MakeScene({});
  SolveOptions options;
  options.refine_points = refine_points;
  const PreparedSolve prepared = PrepareSolve(scene.View(), options);
  return CountCeresFactor(scene.View(), prepared.layout, EliminationOrdering::kPointsFirst, type);
}

/// Without a point to eliminate Ceres chooses what to, and nothing is known of what is left.
TEST(CountCeresFactor, NobodyKnowsWhatIsLeftWhereCeresChoseWhatToEliminate) {
  EXPECT_TRUE(Count(true, ceres::DENSE_SCHUR).num_columns.has_value());
  EXPECT_FALSE(Count(false, ceres::DENSE_SCHUR).num_columns.has_value());
  EXPECT_TRUE(Count(false, ceres::DENSE_NORMAL_CHOLESKY).num_columns.has_value());
}

}  // namespace
}  // namespace bundle

#include "core/schur/cut_chunks.h"

#include <gtest/gtest.h>

#include <cstdint>

#include "core/model/problem_factors.h"
#include "core/prepare/prepare.h"
#include "core/schur/elimination_plan.h"
#include "core/schur/image_parts.h"
#include "support/scene.h"
#include "support/some_factors.h"

namespace bundle {
namespace {

/// Five images, of which the points from `num_seen` on, with priors, are in none.
struct PointsWithPriors {
  explicit PointsWithPriors(int num_seen) {
    testing::SceneOptions options;
    options.num_points = 40;
    scene = testing::MakeScene(options);
    const testing::Scene all = scene;
    scene.observation_image.clear();
    scene.observation_point.clear();
    scene.observation_xy.clear();
    for (int64_t i = 0; i < all.num_observations(); ++i) {
      if (all.observation_point[i] >= num_seen) continue;
      scene.observation_image.push_back(all.observation_image[i]);
      scene.observation_point.push_back(all.observation_point[i]);
      scene.observation_xy.insert(scene.observation_xy.end(), all.observation_xy.begin() + 2 * i,
                                  all.observation_xy.begin() + 2 * i + 2);
    }
    testing::FactorMaker maker(scene);
    for (int p = num_seen; p < options.num_points; ++p) {
      maker.Prior(testing::Kind::kPoint, p, LossType::kTrivial);
    }
    factors = maker.Take();
  }

  AdjustmentProblem View() const {
    AdjustmentProblem problem = scene.View();
    problem.factors = &factors;
    return problem;
  }

  testing::Scene scene;
  ProblemFactors factors;
};

// They are a range of their own: with 3 seen points the last section, with all images the first
// eighth of the points.
TEST(CutChunks, HaveThePointsThatOnlyFactorsDependOn) {
  for (const int num_seen : {3, 20, 39}) {
    const PointsWithPriors all(num_seen);
    const AdjustmentProblem problem = all.View();
    const ParameterLayout layout = PrepareSolve(problem, SolveOptions()).layout;
    const ImageParts parts(problem, layout);
    for (const bool in_sections : {false, true}) {
      const EliminationPlan plan =
          PlanPoints(problem, layout, parts, nullptr, /*keep_order=*/false, in_sections);
      EXPECT_EQ(plan.num_points(), 40);
      int next_point = 0;
      for (const Chunk& chunk : plan.chunks) {
        EXPECT_EQ(chunk.first_point, next_point);
        EXPECT_GT(chunk.last_point, chunk.first_point);
        next_point = chunk.last_point;
      }
      EXPECT_EQ(next_point, 40);
    }
  }
}

}  // namespace
}  // namespace bundle

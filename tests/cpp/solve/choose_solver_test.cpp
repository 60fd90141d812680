#include "core/solve/choose_solver.h"

#include <gtest/gtest.h>

#include "core/solve/prepare.h"
#include "support/scene.h"

namespace bundle {
namespace {

/// Asks about `columns` columns on the camera side, of whose block pairs `density` says how many
/// are not zero: points that are each in one of `num_pieces` pieces of `images` images.
SolverChoice ChooseFor(int64_t columns, int num_pieces, int images) {
  testing::SceneOptions options;
  options.num_images = images;
  testing::Scene scene = testing::MakeScene(options);
  for (int k = 1; k < num_pieces; ++k) {
    testing::Scene piece = testing::MakeScene(options);
    for (auto* ids : {&piece.image_ids, &piece.camera_ids, &piece.point_ids}) {
      for (int64_t& id : *ids) id += 10'000 * k;
    }
    testing::Append(piece, &scene);
  }
  const ProblemView problem = scene.View();
  SolveOptions solve_options;
  solve_options.gauge = Gauge::kNone;
  const ParameterLayout layout = PrepareSolve(problem, solve_options).layout;
  EXPECT_NEAR(CountSchurDensity(problem, layout), 1.0 / num_pieces, 1e-12);
  ProblemShape shape = ShapeOf(layout, 2 * problem.num_observations);
  shape.num_camera_columns = columns;
  return ChooseLinearSolver(problem, layout, shape);
}

TEST(ChooseSolver, ASmallSystemIsDenseUpToAThousandColumns) {
  EXPECT_EQ(ChooseFor(1000, 5, 2).type, LinearSolverType::kDenseSchur);
  EXPECT_EQ(ChooseFor(1001, 5, 2).type, LinearSolverType::kSparseSchur);
}

TEST(ChooseSolver, ALargeSystemIsDenseFromAThirdOnWithASmallMargin) {
  EXPECT_EQ(ChooseFor(1200, 2, 2).type, LinearSolverType::kDenseSchur);   // half of it full
  EXPECT_EQ(ChooseFor(1200, 3, 2).type, LinearSolverType::kSparseSchur);  // a third
}

TEST(ChooseSolver, IteratesBeyondHalfATrillionMultiplyAdds) {
  // n^3 where a factor fills up, which it does from a quarter on: 7937^3 = 5.0e11.
  EXPECT_EQ(ChooseFor(7937, 3, 2).type, LinearSolverType::kSparseSchur);
  EXPECT_EQ(ChooseFor(7938, 3, 2).type, LinearSolverType::kIterativeSchur);
  // n (4 d n)^2 where it stays sparse.
  EXPECT_EQ(ChooseFor(12500, 8, 2).type, LinearSolverType::kSparseSchur);    // 4.88e11
  EXPECT_EQ(ChooseFor(12700, 8, 2).type, LinearSolverType::kIterativeSchur);  // 5.12e11
}

}  // namespace
}  // namespace bundle


#include "core/prepare/choose_solver.h"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <cstdint>
#include <fstream>

#include "core/prepare/prepare.h"
#include "support/scene.h"

namespace bundle {
namespace {

constexpr int kImages = 20;

/// Twenty images, of which `num_pairs` share a point.
testing::Scene Coupled(int num_pairs) {
  testing::SceneOptions options;
  options.num_images = kImages;
  options.num_points = num_pairs;
  testing::Scene scene = testing::MakeScene(options);
  scene.observation_image.clear();
  scene.observation_point.clear();
  int point = 0;
  for (int gap = 1; gap < kImages; ++gap) {
    for (int i = 0; i + gap < kImages && point < num_pairs; ++i, ++point) {
      for (const int image : {i, i + gap}) {
        scene.observation_image.push_back(image);
        scene.observation_point.push_back(point);
      }
    }
  }
  scene.observation_xy.assign(2 * scene.observation_image.size(), 100.0);
  return scene;
}

/// The chosen solver for a number of columns.
LinearSolverType Choose(const testing::Scene& scene, int64_t columns, int64_t free_points = 1,
                        bool cameras_eliminated = false) {
  const AdjustmentProblem problem = scene.View();
  const PreparedSolve prepared = PrepareSolve(problem, SolveOptions());
  ProblemShape shape = ShapeOf(prepared.layout, 2 * problem.num_observations);
  shape.num_camera_columns = columns;
  shape.num_free_points = free_points;
  return ChooseCeresSolver(problem, prepared.layout, shape, cameras_eliminated).type;
}

TEST(ChooseCeresSolver, TakesDenseForSmallSystems) {
  EXPECT_EQ(Choose(Coupled(20), 1000), LinearSolverType::kDenseSchur);
  EXPECT_EQ(Choose(Coupled(20), 1001), LinearSolverType::kSparseSchur);
}

TEST(ChooseCeresSolver, TakesDenseFromAThirdOn) {
  EXPECT_EQ(Choose(Coupled(60), 2000), LinearSolverType::kDenseSchur);   // (20 + 120) / 400 full
  EXPECT_EQ(Choose(Coupled(59), 2000), LinearSolverType::kSparseSchur);  // (20 + 118) / 400
}

TEST(ChooseCeresSolver, IteratesOnWhatIsTooLargeToFactorise) {
  // n^3 = 5e11, then n (4 d n)^2 with d = (20 + 38) / 400
  EXPECT_EQ(Choose(Coupled(190), 7937), LinearSolverType::kDenseSchur);
  EXPECT_EQ(Choose(Coupled(190), 7938), LinearSolverType::kIterativeSchur);
  EXPECT_EQ(Choose(Coupled(19), 11412), LinearSolverType::kSparseSchur);
  EXPECT_EQ(Choose(Coupled(19), 11413), LinearSolverType::kIterativeSchur);
}

TEST(ChooseCeresSolver, EliminatesNothingWithoutFreePoints) {
  EXPECT_EQ(Choose(Coupled(20), 100, 0), LinearSolverType::kSparseNormalCholesky);
}

// The reduced system is then that of the points, three columns each.
TEST(ChooseCeresSolver, LooksAtThePointsWhereCamerasAreEliminated) {
  EXPECT_EQ(Choose(Coupled(20), 100, 333, true), LinearSolverType::kDenseSchur);
  EXPECT_EQ(Choose(Coupled(20), 100, 334, true), LinearSolverType::kIterativeSchur);
  EXPECT_EQ(Choose(Coupled(20), 100, 334, false), LinearSolverType::kDenseSchur);
}

// 7000 columns are 392 MB.
TEST(ChooseCeresSolver, LeavesHalfOfTheMemoryFree) {
  const testing::Scene scene = Coupled(190);
  const auto choose = [&](double left) {
    double pages = 0;
    std::ifstream("/proc/self/statm") >> pages;
    rlimit before{};
    getrlimit(RLIMIT_AS, &before);
    rlimit limit = before;
    limit.rlim_cur = static_cast<rlim_t>(4096 * pages + left);
    setrlimit(RLIMIT_AS, &limit);
    const LinearSolverType type = Choose(scene, 7000);
    setrlimit(RLIMIT_AS, &before);
    return type;
  };
  EXPECT_EQ(choose(700e6), LinearSolverType::kSparseSchur);
  EXPECT_EQ(choose(900e6), LinearSolverType::kDenseSchur);
}

}  // namespace
}  // namespace bundle

#include "core/ceres/solve_with_ceres.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "core/error.h"
#include "core/interface/options.h"
#include "core/prepare/prepare.h"
#include "support/checked_solve.h"
#include "support/cost.h"
#include "support/scene.h"
#include "support/ugly_scenes.h"

namespace bundle {
namespace {

using testing::CheckedSolve;
using testing::MakeScene;
using testing::Scene;
using testing::SceneOptions;

constexpr LinearSolverType kDirect[] = {
    LinearSolverType::kDenseSchur, LinearSolverType::kSparseSchur,
    LinearSolverType::kDenseNormalCholesky, LinearSolverType::kSparseNormalCholesky,
    LinearSolverType::kDenseQr};

SolveOptions Converge(LinearSolverType type = LinearSolverType::kAuto) {
  SolveOptions options;
  options.backend = Backend::kCeres;
  options.linear_solver_type = type;
  options.gauge = Gauge::kTwoCameras;
  options.function_tolerance = 1e-14;
  options.parameter_tolerance = 1e-14;
  options.max_num_iterations = 60;
  options.num_threads = 2;
  return options;
}

TEST(SolveWithCeres, EverySolverFindsTheSameMinimumOfEveryModel) {
  for (int m = 0; m < kNumCameraModels; ++m) {
    for (const int images_per_camera : {1, 5}) {
      SceneOptions scene_options;
      scene_options.model = AllCameraModels()[m].name;
      scene_options.images_per_camera = images_per_camera;
      const Scene scene = MakeScene(scene_options);
      // The focal length alone: more of a flexible lens is not determined by a small scene.
      SolveOptions options = Converge(LinearSolverType::kDenseSchur);
      options.refine_extra = false;
      const double cost = CheckedSolve(scene, options).summary.final_cost;
      // 400 residuals of variance 1/4.
      EXPECT_GT(cost, 15) << scene_options.model;
      EXPECT_LT(cost, 60) << scene_options.model;
      for (const auto& [name, type] : kLinearSolverTypes) {
        if (type == LinearSolverType::kDenseQr && m % 6 != 0) continue;  // slow
        options.linear_solver_type = type;
        const SolveOutput output = CheckedSolve(scene, options);
        EXPECT_TRUE(output.summary.is_solution_usable);
        EXPECT_NEAR(output.summary.final_cost, cost, 1e-6 * cost)
            << scene_options.model << " " << name << ", " << images_per_camera;
      }
    }
  }
}

TEST(SolveWithCeres, EveryLossSeesThroughOutliers) {
  SceneOptions scene_options;
  scene_options.outlier_share = 0.05;
  scene_options.perturbation = 2e-3;  // Tukey's loss is blind beyond its scale
  const Scene scene = MakeScene(scene_options);
  for (const auto& [name, loss] : kLossTypes) {
    for (const LinearSolverType type : kDirect) {
      SolveOptions options = Converge(type);
      options.loss = loss;
      options.loss_scale = 5;
      const SolveOutput output = CheckedSolve(scene, options);
      EXPECT_TRUE(output.summary.is_solution_usable) << name;
      int close = 0;
      SolveOptions squared = options;
      squared.loss = LossType::kTrivial;
      for (int64_t i = 0; i < scene.num_observations(); ++i) {
        close += testing::SolvedCost(scene, output, squared, i, i + 1) < 0.5 * 9;
      }
      // 5 % of 200 are outliers; least squares alone spoils far more.
      EXPECT_GE(close, loss == LossType::kTrivial ? 0 : 180)
          << name << " " << NameOf(type, kLinearSolverTypes);
    }
  }
}

TEST(SolveWithCeres, EveryStrategyGaugeOrderingAndThreadCount) {
  const Scene scene = MakeScene(SceneOptions());
  for (const auto& [gauge_name, gauge] : kGauges) {
    SolveOptions reference = Converge(LinearSolverType::kDenseNormalCholesky);
    reference.gauge = gauge;  // three points fix more than the gauge: a minimum of their own
    const double cost = CheckedSolve(scene, reference).summary.final_cost;
    for (const auto& [strategy_name, strategy] : kTrustRegionStrategies) {
      for (const auto& [ordering_name, ordering] : kEliminationOrderings) {
        for (const int threads : {1, 2, 4}) {
          SolveOptions options = Converge(LinearSolverType::kSparseSchur);
          options.trust_region_strategy_type = strategy;
          options.gauge = gauge;
          options.linear_solver_ordering = ordering;
          options.num_threads = threads;
          EXPECT_NEAR(CheckedSolve(scene, options).summary.final_cost, cost, 1e-6 * cost)
              << strategy_name << " " << gauge_name << " " << ordering_name << " " << threads;
        }
      }
    }
  }
}

TEST(SolveWithCeres, FixedBlocksStayBitForBit) {
  SceneOptions scene_options;
  scene_options.images_per_camera = 2;
  const Scene scene = MakeScene(scene_options);
  for (int bits = 0; bits < 32; ++bits) {
    SolveOptions options = Converge(LinearSolverType::kDenseSchur);
    options.max_num_iterations = 3;
    options.gauge = Gauge::kNone;
    options.refine_poses = bits & 1;
    options.refine_points = bits & 2;
    options.refine_focal = bits & 4;
    options.refine_principal_point = bits & 8;
    options.refine_extra = bits & 16;
    options.fixed_image_ids = {scene.image_ids[1]};
    options.fixed_camera_ids = {scene.camera_ids[2]};
    options.fixed_point_ids = {scene.point_ids[7]};
    const SolveOutput output = CheckedSolve(scene, options);
    const auto same = [](const auto& a, const auto& b, size_t begin, size_t end) {
      return std::equal(a.begin() + begin, a.begin() + end, b.begin() + begin);
    };
    EXPECT_TRUE(same(output.cam_from_world, scene.cam_from_world, 7, 14)) << bits;
    EXPECT_TRUE(same(output.points, scene.points, 21, 24)) << bits;
    EXPECT_TRUE(
        same(output.camera_params, scene.camera_params, 2 * Scene::kStride, 3 * Scene::kStride))
        << bits;
    EXPECT_EQ(output.points == scene.points, !options.refine_points) << bits;
    EXPECT_EQ(output.cam_from_world == scene.cam_from_world, !options.refine_poses) << bits;
  }
}

/// Whatever is wrong with a problem, a solve ends, says so, and writes nothing where it must not.
TEST(SolveWithCeres, UglyProblemsEndOrderly) {
  for (const auto& [scene_name, scene] : testing::UglyScenes()) {
    for (const auto& [name, type] : kLinearSolverTypes) {
      for (const auto& [cheirality_name, cheirality] : kCheiralities) {
        SCOPED_TRACE(::testing::Message() << scene_name << ", " << name << ", " << cheirality_name);
        SolveOptions options = Converge(type);
        options.max_num_iterations = 8;
        options.cheirality = cheirality;
        CheckedSolve(scene, options);
      }
    }
  }
}

TEST(SolveWithCeres, AnUnobservedImageLeavesItsCameraToTheOthers) {
  const Scene scene = MakeScene(SceneOptions());
  Scene with_unobserved = scene;
  testing::AddUnobserved(&with_unobserved);
  SolveOptions options = Converge();
  options.num_threads = 1;  // Ceres' sums depend on the order in which its threads finish
  const SolveOutput expected = CheckedSolve(scene, options);
  const SolveOutput output = CheckedSolve(with_unobserved, options);
  EXPECT_EQ(output.camera_params, expected.camera_params);
  EXPECT_NE(output.camera_params[0], scene.camera_params[0]);
}

TEST(SolveWithCeres, ProgressCanStopIt) {
  const Scene scene = MakeScene(SceneOptions());
  int calls = 0;
  const AdjustmentProblem problem = scene.View();
  const SolveOptions options = Converge();
  const SolveOutput output = SolveWithCeres(
      problem, options, PrepareSolve(problem, options),
      [&](const IterationRecord& record) {
        EXPECT_EQ(record.iteration, calls);
        return ++calls < 3;
      },
      nullptr);
  EXPECT_EQ(calls, 3);
  EXPECT_TRUE(output.summary.interrupted);
  EXPECT_EQ(output.iterations.size(), 3u);
}

TEST(SolveWithCeres, AnUnknownModelIsNamed) {
  Scene scene = MakeScene(SceneOptions());
  scene.camera_models[0] = nullptr;
  EXPECT_THROW(PrepareSolve(scene.View(), SolveOptions()), InputError);
}

}  // namespace
}  // namespace bundle

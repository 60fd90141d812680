
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "core/error.h"
#include "core/interface/options.h"
#include "core/linear/block_structure.h"
#include "core/model/coupled_blocks.h"
#include "core/parallel/thread_pool.h"
#include "core/prepare/choose_solver.h"
#include "core/prepare/prepare.h"
#include "core/solver/solver.h"
#include "support/checked_solve.h"
#include "support/cost.h"
#include "support/no_threads.h"
#include "support/scene.h"
#include "support/ugly_scenes.h"

namespace bundle {
namespace {

using testing::CheckedSolve;
using testing::MakeScene;
using testing::Scene;
using testing::SceneOptions;

constexpr LinearSolverType kSolvers[] = {LinearSolverType::kDenseSchur,
                                         LinearSolverType::kSparseSchur,
                                         LinearSolverType::kIterativeSchur};
constexpr TrustRegionStrategy kStrategies[] = {TrustRegionStrategy::kLevenbergMarquardt,
                                               TrustRegionStrategy::kDogleg,
                                               TrustRegionStrategy::kSubspaceDogleg};

SolveOptions Options(LinearSolverType type = LinearSolverType::kDenseSchur) {
  SolveOptions options;
  options.backend = Backend::kFused;
  options.linear_solver_type = type;
  if (type == LinearSolverType::kIterativeSchur) {
    options.preconditioner_type = PreconditionerType::kSchurJacobi;  // Ceres' automatic one
  }
  options.gauge = Gauge::kTwoCameras;
  options.loss_scale = 5;
  options.max_num_iterations = 12;
  options.num_threads = 2;
  return options;
}

SolveOutput ByCeres(const Scene& scene, SolveOptions options) {
  options.backend = Backend::kCeres;
  return CheckedSolve(scene, options);
}

/// The same costs and decisions, as far as rounding lets two solvers agree.
void ExpectSameSteps(const SolveOutput& found, const SolveOutput& expected, double tolerance) {
  const size_t count = std::min({found.iterations.size(), expected.iterations.size(), size_t{6}});
  EXPECT_EQ(count, std::min(expected.iterations.size(), size_t{6}));
  for (size_t i = 0; i < count; ++i) {
    const IterationRecord &a = found.iterations[i], &b = expected.iterations[i];
    EXPECT_NEAR(a.cost, b.cost, tolerance * b.cost) << "iteration " << i;
    EXPECT_EQ(a.step_is_successful, b.step_is_successful) << "iteration " << i;
    EXPECT_NEAR(a.trust_region_radius, b.trust_region_radius, 1e-4 * b.trust_region_radius)
        << "iteration " << i;
  }
  EXPECT_NEAR(found.summary.final_cost, expected.summary.final_cost,
              std::max(tolerance, 1e-7) * expected.summary.final_cost);
  EXPECT_EQ(found.summary.termination_type, expected.summary.termination_type);
}

class SolveWithFusedTest : public ::testing::TestWithParam<int> {};

TEST_P(SolveWithFusedTest, TakesTheStepsOfCeres) {
  for (const int images_per_camera : {1, 2, 5}) {
    SceneOptions scene_options;
    scene_options.model = AllCameraModels()[GetParam()].name;
    scene_options.images_per_camera = images_per_camera;
    const Scene scene = MakeScene(scene_options);
    for (const LinearSolverType type : kSolvers) {
      SCOPED_TRACE(::testing::Message()
                   << NameOf(type, kLinearSolverTypes) << ", " << images_per_camera);
      SolveOptions options = Options(type);
      options.refine_extra = false;  // a small scene does not determine a flexible lens
      // Twenty conjugate gradients magnify rounding: tests/fused/test_same_steps_as_ceres.py
      // measures by how much.
      const double tolerance = type == LinearSolverType::kIterativeSchur ? 2e-6 : 1e-8;
      ExpectSameSteps(CheckedSolve(scene, options), ByCeres(scene, options), tolerance);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(All, SolveWithFusedTest, ::testing::Range(0, kNumCameraModels),
                         [](const auto& test) { return AllCameraModels()[test.param].name; });

TEST(SolveWithFused, EveryLossGaugeAndStrategy) {
  SceneOptions scene_options;
  scene_options.outlier_share = 0.05;
  scene_options.perturbation = 2e-3;
  const Scene scene = MakeScene(scene_options);
  for (const auto& [loss_name, loss] : kLossTypes) {
    for (const auto& [gauge_name, gauge] : kGauges) {
      for (const TrustRegionStrategy strategy : kStrategies) {
        // A dogleg damps by 1e-8 only: without a gauge its equations are next to singular, and no
        // two ways to solve them agree.
        const bool damped = strategy == TrustRegionStrategy::kLevenbergMarquardt;
        if (gauge == Gauge::kNone && !damped) continue;
        SCOPED_TRACE(::testing::Message()
                     << loss_name << " " << gauge_name << " " << static_cast<int>(strategy));
        SolveOptions options = Options();
        options.loss = loss;
        options.gauge = gauge;
        options.trust_region_strategy_type = strategy;
        ExpectSameSteps(CheckedSolve(scene, options), ByCeres(scene, options), 1e-8);
      }
    }
  }
}

/// A result does not depend on how many threads found it, to the last bit.
TEST(SolveWithFused, EveryThreadCountGivesTheSameBits) {
  SceneOptions scene_options;
  scene_options.num_images = 12;
  scene_options.num_points = 300;  // several chunks
  scene_options.track_length = 6;
  const Scene scene = MakeScene(scene_options);
  for (const LinearSolverType type : kSolvers) {
    SolveOptions options = Options(type);
    options.num_threads = 1;
    options.max_num_iterations = 6;
    const SolveOutput expected = CheckedSolve(scene, options);
    for (const int threads : {2, 3, 4}) {
      options.num_threads = threads;
      const SolveOutput found = CheckedSolve(scene, options);
      EXPECT_EQ(found.points, expected.points) << NameOf(type, kLinearSolverTypes) << threads;
      EXPECT_EQ(found.cam_from_world, expected.cam_from_world);
      EXPECT_EQ(found.camera_params, expected.camera_params);
    }
  }
}

/// The scene with its points in reverse order.
Scene WithPointsReversed(Scene scene) {
  const auto count = static_cast<int>(scene.point_ids.size());
  const std::vector<double> points = scene.points;
  for (int p = 0; p < count; ++p) {
    std::copy_n(&points[3 * (count - 1 - p)], 3, &scene.points[3 * p]);
  }
  std::reverse(scene.point_ids.begin(), scene.point_ids.end());
  for (int32_t& point : scene.observation_point) point = count - 1 - point;
  return scene;
}

// Sums of conjugate gradients are on a grid (schur/assembly/sum_grid.h).
TEST(SolveWithFused, TheOrderOfPointsChangesNoBitOfConjugateGradients) {
  for (const int images_per_camera : {1, 20}) {
    SceneOptions scene_options;
    scene_options.num_images = 20;
    scene_options.num_points = 400;
    scene_options.images_per_camera = images_per_camera;
    const Scene scene = MakeScene(scene_options);
    SolveOptions options = Options(LinearSolverType::kIterativeSchur);
    options.schur_complement = SchurComplement::kExplicit;
    options.max_num_iterations = 6;
    const SolveOutput expected = CheckedSolve(scene, options);
    const SolveOutput found = CheckedSolve(WithPointsReversed(scene), options);
    EXPECT_EQ(found.cam_from_world, expected.cam_from_world);
    EXPECT_EQ(found.camera_params, expected.camera_params);
  }
}

TEST(SolveWithFused, ChoosesASolverByAllPairsOfObservations) {
  SceneOptions scene_options;
  scene_options.num_images = 60;
  scene_options.num_points = 400;
  const Scene scene = MakeScene(scene_options);
  const AdjustmentProblem problem = scene.View();
  SolveOptions options = Options(LinearSolverType::kAuto);
  options.schur_complement = SchurComplement::kExplicit;
  options.max_num_iterations = 0;
  const ParameterLayout layout = PrepareSolve(problem, options).layout;
  const BlockStructure structure =
      SparseStructure(layout.BlockSizes(), FindCoupledBlocks(problem, layout));
  const SolverChoice expected =
      ChooseLinearSolver(structure, FindFillOrdering(structure), options.num_threads, 1e15,
                         /*num_observations=*/0, /*num_pairs=*/400 * (60 * 59 / 2));
  const SolveOutput found = CheckedSolve(scene, options);
  EXPECT_EQ(found.summary.linear_solver_choice, expected.reason);
}

TEST(SolveWithFused, UglyProblemsEndOrderly) {
  for (const auto& [scene_name, scene] : testing::UglyScenes()) {
    for (const LinearSolverType type : kSolvers) {
      for (const TrustRegionStrategy strategy : kStrategies) {
        if (type == LinearSolverType::kIterativeSchur &&
            strategy != TrustRegionStrategy::kLevenbergMarquardt) {
          continue;
        }
        for (const auto& [cheirality_name, cheirality] : kCheiralities) {
          SCOPED_TRACE(::testing::Message()
                       << scene_name << ", " << NameOf(type, kLinearSolverTypes) << ", "
                       << static_cast<int>(strategy) << ", " << cheirality_name);
          SolveOptions options = Options(type);
          options.max_num_iterations = 8;
          options.cheirality = cheirality;
          options.trust_region_strategy_type = strategy;
          options.num_threads = 1 + static_cast<int>(cheirality);
          if (scene.num_observations() == 0) {
            EXPECT_THROW(CheckedSolve(scene, options), InputError);
            continue;
          }
          const SolveOutput found = CheckedSolve(scene, options);
          const SolveOutput expected = ByCeres(scene, options);
          // At 1e200 rounding decides where a subspace dogleg goes.
          const bool is_rounding = std::string(scene_name) == "points far away" &&
                                   strategy == TrustRegionStrategy::kSubspaceDogleg;
          if (!is_rounding) {
            EXPECT_EQ(found.summary.is_solution_usable, expected.summary.is_solution_usable);
          }
          if (type != LinearSolverType::kIterativeSchur) continue;
          options.preconditioner_type = PreconditionerType::kTwoLevel;
          CheckedSolve(scene, options);
        }
      }
    }
  }
}

TEST(SolveWithFused, WhateverIsFixed) {
  SceneOptions scene_options;
  scene_options.images_per_camera = 2;
  const Scene scene = MakeScene(scene_options);
  for (int bits = 0; bits < 64; ++bits) {
    SCOPED_TRACE(bits);
    SolveOptions options = Options(kSolvers[bits % 2]);
    options.gauge = Gauge::kNone;
    options.max_num_iterations = 4;
    options.refine_poses = bits & 1;
    options.refine_points = bits & 2;
    options.refine_focal = bits & 4;
    options.refine_principal_point = bits & 8;
    options.refine_extra = bits & 16;
    if (bits & 32) {
      options.fixed_image_ids = {scene.image_ids[1]};
      options.fixed_camera_ids = {scene.camera_ids[2]};
      options.fixed_point_ids = {scene.point_ids[7]};
    }
    if ((bits & 29) == 0) {
      EXPECT_THROW(CheckedSolve(scene, options), InputError);
      continue;
    }
    const SolveOutput found = CheckedSolve(scene, options);
    ExpectSameSteps(found, ByCeres(scene, options), 1e-7);
    EXPECT_EQ(found.cam_from_world == scene.cam_from_world, !options.refine_poses);
  }
}

TEST(SolveWithFused, ProgressCanStopIt) {
  const Scene scene = MakeScene(SceneOptions());
  int calls = 0;
  const SolveOutput output = Solve(scene.View(), Options(), [&](const IterationRecord& record) {
    EXPECT_EQ(record.iteration, calls);
    return ++calls < 3;
  });
  EXPECT_EQ(calls, 3);
  EXPECT_TRUE(output.summary.interrupted);
  EXPECT_EQ(output.iterations.size(), 3u);
}

/// Wherever they look for it.
TEST(SolveWithFused, LeavesAStepThatIsInterruptedAsCeresDoes) {
  SceneOptions scene_options;
  scene_options.num_images = 8;
  scene_options.num_points = 60;
  const Scene scene = MakeScene(scene_options);
  const AdjustmentProblem problem = scene.View();
  for (const Backend backend : {Backend::kFused, Backend::kCeres}) {
    for (const LinearSolverType type : kSolvers) {
      SolveOptions options = Options(type);
      options.backend = backend;
      const SolveOutput whole = Solve(problem, options, nullptr);
      int num_interrupted = 0;
      for (int look = 1; look < 60; ++look) {
        SCOPED_TRACE(::testing::Message() << UpperName(backend, kBackends) << " "
                                          << UpperName(type, kLinearSolverTypes) << " " << look);
        int asked = 0;
        const InterruptionScope scope([&] { return ++asked > look; }, {});
        SolveOutput output;
        try {
          output = Solve(problem, options, nullptr);
        } catch (const Interrupted&) {
          continue;  // in the first evaluation
        }
        const SolveSummary& summary = output.summary;
        if (!summary.interrupted) continue;  // at its end
        ++num_interrupted;
        EXPECT_EQ(summary.termination_type, "USER_SUCCESS");
        EXPECT_TRUE(summary.is_solution_usable);
        double least = summary.initial_cost;
        for (size_t i = 0; i < output.iterations.size(); ++i) {
          EXPECT_NEAR(output.iterations[i].cost, whole.iterations[i].cost,
                      1e-9 * whole.iterations[i].cost);
          least = std::min(least, output.iterations[i].cost);
        }
        EXPECT_EQ(summary.final_cost, least);
        EXPECT_EQ(summary.num_successful_steps + summary.num_unsuccessful_steps,
                  static_cast<int>(output.iterations.size()));
        Scene solved = scene;
        solved.cam_from_world = output.cam_from_world;
        solved.camera_params = output.camera_params;
        solved.points.assign(output.points.begin(), output.points.end());
        EXPECT_NEAR(static_cast<double>(testing::ProblemCost(solved.View(), options)), least,
                    1e-9 * least);
      }
      EXPECT_GT(num_interrupted, 5);
    }
  }
}

TEST(SolveWithFused, ThrowsWhereItIsInterruptedBeforeTheFirstEvaluationAsCeresDoes) {
  const Scene scene = MakeScene(SceneOptions());
  const AdjustmentProblem problem = scene.View();
  for (const Backend backend : {Backend::kFused, Backend::kCeres}) {
    SolveOptions options = Options();
    options.backend = backend;
    const InterruptionScope scope([] { return true; });
    EXPECT_THROW(Solve(problem, options, nullptr), Interrupted);
  }
}

TEST(SolveWithFused, NeedsNoSecondThreadAndCeresNeither) {
  const Scene scene = MakeScene(SceneOptions());
  const AdjustmentProblem problem = scene.View();
  for (const Backend backend : {Backend::kFused, Backend::kCeres}) {
    for (const LinearSolverType type : kSolvers) {
      SolveOptions options = Options(type);
      options.backend = backend;
      options.num_threads = 4;
      const SolveOutput expected = Solve(problem, options, nullptr);
      const testing::NoThreads none;
      const SolveOutput found = Solve(problem, options, nullptr);
      EXPECT_NEAR(found.summary.final_cost, expected.summary.final_cost,
                  1e-6 * expected.summary.final_cost);
    }
  }
}

}  // namespace
}  // namespace bundle

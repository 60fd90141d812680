#include "core/ceres/solve_with_ceres.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "core/error.h"
#include "core/solve/prepare.h"
#include "support/cost.h"
#include "support/scene.h"

namespace bundle {
namespace {

using testing::Append;
using testing::MakeScene;
using testing::ProblemCost;
using testing::Scene;
using testing::SceneOptions;
using testing::SolvedCost;

constexpr LinearSolverType kDirect[] = {
    LinearSolverType::kDenseSchur, LinearSolverType::kSparseSchur,
    LinearSolverType::kDenseNormalCholesky, LinearSolverType::kSparseNormalCholesky,
    LinearSolverType::kDenseQr};

const char* NameOf(LinearSolverType type) {
  for (const auto& [name, value] : kLinearSolverTypes) {
    if (value == type) return name.data();
  }
  return "?";
}

SolveOptions Converge(LinearSolverType type = LinearSolverType::kAuto) {
  SolveOptions options;
  options.linear_solver_type = type;
  options.gauge = Gauge::kTwoCameras;
  options.function_tolerance = 1e-14;
  options.parameter_tolerance = 1e-14;
  options.max_num_iterations = 60;
  options.num_threads = 2;
  return options;
}

/// What holds for every solve, however it ends: sizes, and a summary that says the truth.
SolveOutput Solve(const Scene& scene, const SolveOptions& options) {
  const ProblemView problem = scene.View();
  SolveOutput output = SolveWithCeres(problem, options, PrepareSolve(problem, options), nullptr);
  EXPECT_EQ(output.cam_from_world.size(), scene.cam_from_world.size());
  EXPECT_EQ(output.camera_params.size(), scene.camera_params.size());
  EXPECT_EQ(output.points.size(), scene.points.size());
  if (!output.summary.is_solution_usable) {
    EXPECT_EQ(output.cam_from_world, scene.cam_from_world);
    EXPECT_EQ(output.points, scene.points);
    return output;
  }
  const long double initial = ProblemCost(problem, options);
  const long double final_cost = SolvedCost(scene, output, options);
  EXPECT_NEAR(output.summary.initial_cost, static_cast<double>(initial),
              1e-12 * static_cast<double>(initial));
  EXPECT_NEAR(output.summary.final_cost, static_cast<double>(final_cost),
              1e-9 * static_cast<double>(final_cost) + 1e-15);
  EXPECT_LE(output.summary.final_cost, output.summary.initial_cost);
  return output;
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
      const double cost = Solve(scene, options).summary.final_cost;
      // 400 residuals of variance 1/4.
      EXPECT_GT(cost, 15) << scene_options.model;
      EXPECT_LT(cost, 60) << scene_options.model;
      for (const auto& [name, type] : kLinearSolverTypes) {
        if (type == LinearSolverType::kDenseQr && m % 6 != 0) continue;  // slow
        options.linear_solver_type = type;
        const SolveOutput output = Solve(scene, options);
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
      const SolveOutput output = Solve(scene, options);
      EXPECT_TRUE(output.summary.is_solution_usable) << name;
      int close = 0;
      SolveOptions squared = options;
      squared.loss = LossType::kTrivial;
      for (int64_t i = 0; i < scene.num_observations(); ++i) {
        close += testing::SolvedCost(scene, output, squared, i, i + 1) < 0.5 * 9;
      }
      // 5 % of 200 are outliers; least squares alone spoils far more.
      EXPECT_GE(close, loss == LossType::kTrivial ? 0 : 180) << name << " " << NameOf(type);
    }
  }
}

TEST(SolveWithCeres, EveryStrategyGaugeOrderingAndThreadCount) {
  const Scene scene = MakeScene(SceneOptions());
  for (const auto& [gauge_name, gauge] : kGauges) {
    SolveOptions reference = Converge(LinearSolverType::kDenseNormalCholesky);
    reference.gauge = gauge;  // three points fix more than the gauge: a minimum of their own
    const double cost = Solve(scene, reference).summary.final_cost;
    for (const auto& [strategy_name, strategy] : kTrustRegionStrategies) {
      for (const auto& [ordering_name, ordering] : kEliminationOrderings) {
        for (const int threads : {1, 2, 4}) {
          SolveOptions options = Converge(LinearSolverType::kSparseSchur);
          options.trust_region_strategy_type = strategy;
          options.gauge = gauge;
          options.linear_solver_ordering = ordering;
          options.num_threads = threads;
          EXPECT_NEAR(Solve(scene, options).summary.final_cost, cost, 1e-6 * cost)
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
    const SolveOutput output = Solve(scene, options);
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

Scene With(const SceneOptions& options, void (*change)(Scene*)) {
  Scene scene = MakeScene(options);
  change(&scene);
  return scene;
}

/// Whatever is wrong with a problem, a solve ends, says so, and writes nothing where it must not.
TEST(SolveWithCeres, UglyProblemsEndOrderly) {
  SceneOptions one_image, two_points, clean, mixed;
  one_image.num_images = 1;
  two_points.num_points = 2;
  mixed.model = "OPENCV_FISHEYE";
  mixed.images_per_camera = 3;
  const Scene scenes[] = {
      Scene(),
      MakeScene(one_image),
      MakeScene(two_points),
      With(clean, [](Scene* s) { testing::PutPointsBehind(4, s); }),
      With(clean, [](Scene* s) { testing::PutPointsBehind(1, s); }),
      With(clean, [](Scene* s) { testing::RepeatObservations(3, s); }),
      With(clean, [](Scene* s) { testing::ShuffleObservations(5, s); }),
      With(clean, [](Scene* s) { testing::AddUnobserved(s); }),
      With(clean, [](Scene* s) { s->points.assign(s->points.size(), 0); }),
      With(clean, [](Scene* s) { s->points.assign(s->points.size(), 1e200); }),
      With(clean, [](Scene* s) { s->observation_xy.assign(s->observation_xy.size(), 1e160); }),
      With(mixed, [](Scene* s) { Append(MakeScene(SceneOptions()), s); }),
  };
  int index = 0;
  for (const Scene& scene : scenes) {
    for (const auto& [name, type] : kLinearSolverTypes) {
      for (const auto& [cheirality_name, cheirality] : kCheiralities) {
        SCOPED_TRACE(::testing::Message()
                     << "scene " << index << " " << name << " " << cheirality_name);
        SolveOptions options = Converge(type);
        options.max_num_iterations = 8;
        options.cheirality = cheirality;
        Solve(scene, options);
      }
    }
    ++index;
  }
}

TEST(SolveWithCeres, AnUnobservedImageLeavesItsCameraToTheOthers) {
  const Scene scene = MakeScene(SceneOptions());
  const Scene with_unobserved = With(SceneOptions(), testing::AddUnobserved);
  const SolveOutput expected = Solve(scene, Converge());
  const SolveOutput output = Solve(with_unobserved, Converge());
  EXPECT_EQ(output.camera_params, expected.camera_params);
  EXPECT_NE(output.camera_params[0], scene.camera_params[0]);
}

TEST(SolveWithCeres, ProgressCanStopIt) {
  const Scene scene = MakeScene(SceneOptions());
  int calls = 0;
  const ProblemView problem = scene.View();
  const SolveOptions options = Converge();
  const SolveOutput output = SolveWithCeres(problem, options, PrepareSolve(problem, options),
                                            [&](const IterationRecord& record) {
                                              EXPECT_EQ(record.iteration, calls);
                                              return ++calls < 3;
                                            });
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

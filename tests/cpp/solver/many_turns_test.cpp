/// Images that turn further than a chart goes (factors/reprojection.h): both backends take the same
/// steps, and get there.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "core/ceres/ceres_version.h"
#include "core/interface/options.h"
#include "core/model/factor_costs.h"
#include "core/model/problem_factors.h"
#include "core/solver/solver.h"
#include "support/cost.h"
#include "support/helix_factor.h"
#include "support/scene.h"

namespace bundle {
namespace {

using testing::Helix;
using testing::HelixFactor;
using testing::MakeScene;
using testing::Scene;
using testing::SceneOptions;
using Fault = HelixFactor::Fault;

constexpr double kTarget[3] = {0.5, -0.25, 9};  // 18 radians away

/// A scene, and an image at height 0 that only a factor touches, turned away from the helix.
struct Walk {
  Walk() {
    SceneOptions options;
    options.num_images = 4;
    options.num_points = 14;
    scene = MakeScene(options);
    AddUnobserved(&scene);
    image = scene.num_images() - 1;
    const double turn[3] = {0.4, -0.3, 0.2};
    ExpQuaternion(turn, &scene.cam_from_world[7 * static_cast<size_t>(image)]);
  }

  SolveOutput Solve(const SolveOptions& options, HelixFactor::Faults faults = nullptr) const {
    const ProblemFactors factors = Helix(image, {kTarget, kTarget + 3}, std::move(faults));
    AdjustmentProblem problem = scene.View();
    problem.factors = &factors;
    return bundle::Solve(problem, options, nullptr);
  }

  double Height(const SolveOutput& output) const {
    return output.cam_from_world[7 * static_cast<size_t>(image) + 6];
  }

  /// 1/2 ||r||^2 of the factor, and of all, at a solution.
  double FactorCost(const SolveOutput& output) const {
    const ProblemFactors factors = Helix(image, {kTarget, kTarget + 3});
    AdjustmentProblem problem = scene.View();
    problem.cam_from_world = output.cam_from_world.data();
    problem.factors = &factors;
    return FactorCosts(problem)[0];
  }
  double Cost(const SolveOutput& output, const SolveOptions& options) const {
    return static_cast<double>(testing::SolvedCost(scene, output, options)) + FactorCost(output);
  }

  Scene scene;
  int image = 0;
};

SolveOptions Options(Backend backend, TrustRegionStrategy strategy) {
  SolveOptions options;
  options.backend = backend;
  options.trust_region_strategy_type = strategy;
  options.linear_solver_type = LinearSolverType::kDenseSchur;
  options.gauge = Gauge::kTwoCameras;
  options.function_tolerance = 1e-12;
  options.max_num_iterations = 200;
  options.num_threads = 2;
  return options;
}

TEST(ManyTurns, BothBackendsTakeTheSameStepsToTheEnd) {
  const Walk walk;
  for (const TrustRegionStrategy strategy :
       {TrustRegionStrategy::kLevenbergMarquardt, TrustRegionStrategy::kDogleg,
        TrustRegionStrategy::kSubspaceDogleg}) {
    SCOPED_TRACE(NameOf(strategy, kTrustRegionStrategies));
    const SolveOutput found = walk.Solve(Options(Backend::kFused, strategy));
    const SolveOutput expected = walk.Solve(Options(Backend::kCeres, strategy));
    for (const SolveOutput* output : {&found, &expected}) {
      EXPECT_EQ(output->summary.termination_type, "CONVERGENCE");
      EXPECT_NEAR(walk.Height(*output), kTarget[2], 1e-5);
      EXPECT_LT(walk.FactorCost(*output), 1e-9);
    }
    EXPECT_GT(found.iterations.size(), 5u);
    ASSERT_EQ(found.iterations.size(), expected.iterations.size());
    bool measures_step = CERES_VERSION_MAJOR == 2 && CERES_VERSION_MINOR == 1;
    for (size_t i = 0; i < found.iterations.size(); ++i) {
      const IterationRecord &a = found.iterations[i], &b = expected.iterations[i];
      EXPECT_EQ(a.step_is_successful, b.step_is_successful) << i;
      EXPECT_NEAR(a.cost, b.cost, 1e-9 * b.cost) << i;
      if (measures_step) {
        EXPECT_NEAR(a.step_norm, b.step_norm, 1e-7 * (1 + b.step_norm)) << i;
      }
      measures_step = measures_step || (i > 0 && b.step_is_successful);
      EXPECT_NEAR(a.trust_region_radius, b.trust_region_radius, 1e-7 * b.trust_region_radius) << i;
    }
  }
}

constexpr double kEdge = 6;  ///< a height several charts away

Fault NoDerivativesBeyond(double height, bool jacobian) {
  return height > kEdge && jacobian ? Fault::kNoValue : Fault::kNone;
}

Fault HigherCostBeyond(double height, bool jacobian) {
  return height > kEdge && jacobian ? Fault::kHigherCost : Fault::kNone;
}

/// A state that cannot be linearised is given up, by Ceres with all that went before it. Whatever
/// comes back has to be read about the anchors that it was written about.
TEST(ManyTurns, AFailedSolveEndsAtAStateThatItHad) {
  const Walk walk;
  for (const Backend backend : {Backend::kFused, Backend::kCeres}) {
    SCOPED_TRACE(NameOf(backend, kBackends));
    const SolveOptions options = Options(backend, TrustRegionStrategy::kLevenbergMarquardt);
    const SolveOutput output = walk.Solve(options, NoDerivativesBeyond);
    EXPECT_EQ(output.summary.termination_type, "FAILURE");
    EXPECT_GT(output.summary.num_successful_steps, 2);
    if (backend == Backend::kCeres) {
      EXPECT_EQ(output.cam_from_world, walk.scene.cam_from_world);
    } else {
      EXPECT_LT(walk.Height(output), kEdge);
      EXPECT_GT(walk.Height(output), kEdge - 2);
      EXPECT_NEAR(output.summary.final_cost, walk.Cost(output, options),
                  1e-9 * output.summary.final_cost);
    }
  }
}

/// Ceres goes on after states that are no better than the best one, and ends with the best.
TEST(ManyTurns, TheBestStateKeepsItsAnchors) {
  const Walk walk;
  const SolveOptions options = Options(Backend::kCeres, TrustRegionStrategy::kLevenbergMarquardt);
  const SolveOutput output = walk.Solve(options, HigherCostBeyond);
  EXPECT_TRUE(output.summary.is_solution_usable);
  EXPECT_LT(walk.Height(output), kEdge);
  EXPECT_GT(walk.Height(output), kEdge - 2);
  EXPECT_NEAR(output.summary.final_cost, walk.Cost(output, options),
              1e-9 * output.summary.final_cost);
  EXPECT_GT(output.iterations.back().cost, output.summary.final_cost + 1e5);
}

}  // namespace
}  // namespace bundle

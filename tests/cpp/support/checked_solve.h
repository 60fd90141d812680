#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/solver/solver.h"
#include "support/cost.h"
#include "support/scene.h"

namespace bundle::testing {

/// Invariants of every solve, however it ends: sizes, and a summary that is correct.
inline SolveOutput CheckedSolve(const Scene& scene, const SolveOptions& options) {
  const AdjustmentProblem problem = scene.View();
  SolveOutput output = Solve(problem, options, nullptr);
  EXPECT_EQ(output.cam_from_world.size(), scene.cam_from_world.size());
  EXPECT_EQ(output.camera_params.size(), scene.camera_params.size());
  EXPECT_EQ(output.points.size(), scene.points.size());
  const auto is_of_observations_behind = [](const Warning& warning) {
    return warning.kind == WarningKind::kTooManyBehind;
  };
  const std::vector<Warning>& warnings = output.summary.warnings;
  if (std::any_of(warnings.begin(), warnings.end(), is_of_observations_behind)) {
    EXPECT_FALSE(output.summary.is_solution_usable);
    return output;  // the state is shown as it ended
  }
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

}  // namespace bundle::testing

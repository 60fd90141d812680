#include "core/prepare/prepare.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/checking/check_solution.h"
#include "core/error.h"
#include "core/factors/reprojection.h"
#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/model/gauge.h"
#include "core/model/parameter_layout.h"
#include "core/model/problem_factors.h"
#include "core/problem/reprojection_errors.h"
#include "core/sums/communicator.h"

namespace bundle {

namespace {

std::string FindFactorForCeres(const AdjustmentProblem& problem, const ParameterLayout& layout) {
  const std::vector<FactorUnknowns> unknowns = FindFactorUnknowns(problem, layout);
  for (size_t f = 0; f < unknowns.size(); ++f) {
    const Factor& factor = *problem.factors->factors[f];
    if (!factor.IsThreadSafe()) return factor.name() + ", a function in Python";
    if (!LeavesPointsApart(unknowns[f])) {
      return factor.name() + ", of a point and another refined variable";
    }
  }
  return "";
}

/// A gauge that removes degrees of freedom although factors may fix them.
std::string FindSuperfluousGauge(const AdjustmentProblem& problem, const FreeParameters& before,
                                 const FreeParameters& after) {
  const bool is_held = before.pose != after.pose || before.point != after.point ||
                       before.frame != after.frame || before.sensor != after.sensor;
  if (!is_held || !MayFixGauge(problem)) return "";
  return "The gauge is fixed although factors may determine the world: the fixed numbers do not "
         "follow the factors. Use gauge none if factors hold all of the world, with its scale.";
}

}  // namespace

FreeParameters ChooseFreeParameters(const AdjustmentProblem& problem, const SolveOptions& options,
                                    std::vector<Warning>* warnings) {
  FreeParameters free = SelectFreeParameters(problem, options);
  const FreeParameters without_gauge = problem.factors != nullptr ? free : FreeParameters();
  Warn(WarningKind::kGaugeNotHeld, FixGauge(problem, options.gauge, &free), warnings);
  if (problem.factors != nullptr) {
    Warn(WarningKind::kGaugeBesideFactors, FindSuperfluousGauge(problem, without_gauge, free),
         warnings);
  }
  return free;
}

PreparedSolve PrepareSolve(const AdjustmentProblem& problem, const SolveOptions& options) {
  CheckCameraModelsKnown(problem);
  std::vector<Warning> warnings;
  ParameterLayout layout(problem, ChooseFreeParameters(problem, options, &warnings));
  LargeVector<int64_t> track_lengths = TrackLengths(problem);
  Warn(WarningKind::kPointsSeenOnce, CountPointsSeenOnce(problem, layout, track_lengths),
       &warnings);
  std::string factor_for_ceres =
      FirstOverRanks(problem.division.communicator, FindFactorForCeres(problem, layout));
  const auto longest = std::max_element(track_lengths.begin(), track_lengths.end());
  const int64_t longest_track = longest == track_lengths.end() ? 0 : *longest;
  const auto longest_of_all =
      MaxOverRanks(problem.division.communicator, static_cast<double>(longest_track));
  const int64_t num_free =
      SumOverRanks(problem.division.communicator, int64_t{layout.num_free_points()});
  return {std::move(layout), std::move(warnings),          std::move(track_lengths),
          num_free,          std::llround(longest_of_all), std::move(factor_for_ceres)};
}

bool IsIterative(LinearSolverType type) {
  return type == LinearSolverType::kIterativeSchur || type == LinearSolverType::kCgnr;
}

void CheckTrustRegion(const SolveOptions& options) {
  if (IsIterative(options.linear_solver_type) &&
      options.trust_region_strategy_type != TrustRegionStrategy::kLevenbergMarquardt) {
    throw InputError(
        "trust_region_strategy_type: expected levenberg_marquardt with an iterative solver; dogleg "
        "needs exact steps");
  }
}

std::string FindIdlePreconditioner(const SolveOptions& options) {
  if (IsIterative(options.linear_solver_type) ||
      options.preconditioner_type == PreconditionerType::kAuto) {
    return "";
  }
  return "The preconditioner is not used: " +
         UpperName(options.linear_solver_type, kLinearSolverTypes) + " is a direct solver.";
}

std::string FindIdleOrdering(const SolveOptions& options) {
  const bool orders = options.linear_solver_type != LinearSolverType::kDenseNormalCholesky &&
                      options.linear_solver_type != LinearSolverType::kDenseQr &&
                      options.linear_solver_type != LinearSolverType::kCgnr;
  if (orders || options.linear_solver_ordering == EliminationOrdering::kPointsFirst) return "";
  return "The ordering is not used: " + UpperName(options.linear_solver_type, kLinearSolverTypes) +
         " does not eliminate block by block.";
}

void RefuseTooLarge(const ProblemView& problem) {
  constexpr int64_t kMost = std::numeric_limits<int>::max();
  const auto refuse = [](const char* what, int64_t most, int64_t found) {
    throw InputError(std::string(what) + ": expected at most " + std::to_string(most) +
                     " in one solve, found " + std::to_string(found));
  };
  if (problem.num_observations > kMost / 2) {
    refuse("observation_xy", kMost / 2, problem.num_observations);  // two residuals each
  }
  // Three parameters per point, and up to this many per image and camera.
  const int64_t camera_state =
      int64_t{kPoseSize} *
          (int64_t{problem.num_images} + problem.num_frames + problem.num_sensors) +
      int64_t{kMaxCameraParams} * (int64_t{problem.num_images} + problem.num_cameras);
  if (camera_state > kMost)
    refuse("cam_from_world", kMost / (kPoseSize + 2 * kMaxCameraParams), problem.num_images);
  const int64_t most_points = (kMost - camera_state) / 3;
  if (problem.num_points > most_points) refuse("points", most_points, problem.num_points);
}

}  // namespace bundle

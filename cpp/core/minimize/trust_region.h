#pragma once

#include <limits>
#include <string>
#include <vector>

#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/minimize/least_squares.h"

namespace bundle {

struct MinimizerSummary {
  bool HasConverged() const { return termination_type == "CONVERGENCE"; }

  std::string termination_type;  ///< CONVERGENCE, NO_CONVERGENCE, FAILURE or USER_SUCCESS
  std::string message;
  bool interrupted = false;
  double untaken_decrease = 0;  ///< SolveSummary::untaken_decrease
  /// SolveSummary::distance_in_sigmas, largest_camera_step_in_sigmas
  double distance_in_sigmas = std::numeric_limits<double>::quiet_NaN();
  double largest_camera_step_in_sigmas = std::numeric_limits<double>::quiet_NaN();
  /// LeastSquares::CostOfAll of the best state, and the cost in its record.
  double best_cost_of_all = std::numeric_limits<double>::infinity();
  double best_cost = 0;
  bool is_best = true;            ///< the last state is the best one
  bool returned_to_best = false;  ///< the final state is that of best_cost, not the last one
  int num_successful_steps = 0;
  int num_unsuccessful_steps = 0;
  int num_linear_solves = 0;
  int num_linearizations = 0;
  int num_candidates = 0;
  double linearization_time_in_seconds = 0;  ///< time of Linearize
  double solve_time_in_seconds = 0;          ///< time of SolveNewton
  double candidate_time_in_seconds = 0;      ///< time of all passes that evaluate steps
  std::vector<IterationRecord> iterations;   ///< costs do not include the problem's `fixed_cost`
};

/// Minimises as ceres::internal::TrustRegionMinimizer does, step by step: same strategies, same
/// radius, same three stopping tests. At the end, the state of `problem` is the best one.
///
/// `before`: the summary of the solve that led to the state of `problem`, if this continues from
/// there because other residuals count now. Everything restarts, but the iterations continue those
/// of `before` (the first is the evaluation of the state), and `options` limit all of them
/// together.
MinimizerSummary Minimize(const SolveOptions& options, const ProgressCallback& progress,
                          LeastSquares* problem, MinimizerSummary before = {});

}  // namespace bundle

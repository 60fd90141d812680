#pragma once

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

#pragma once

#include <functional>
#include <string>
#include <vector>

#include "core/fused/minimize/least_squares.h"
#include "core/solve/options.h"
#include "core/solve/solve.h"
#include "core/solve/summary.h"

namespace bundle::fused {

struct Minimum {
  std::string termination_type;  ///< CONVERGENCE, NO_CONVERGENCE, FAILURE or USER_SUCCESS
  std::string message;
  bool interrupted = false;
  int num_successful_steps = 0;
  int num_unsuccessful_steps = 0;
  int num_linear_solves = 0;
  int num_linearizations = 0;
  int num_candidates = 0;
  double linearization_time_in_seconds = 0;  ///< Linearize
  double solve_time_in_seconds = 0;          ///< SolveNewton
  double candidate_time_in_seconds = 0;      ///< TryNewton, Products, TryCombination
  std::vector<IterationRecord> iterations;   ///< costs without `fixed_cost` of the problem
};

/// Minimises as ceres::internal::TrustRegionMinimizer does, step by step: same strategies, same
/// radius, same three stopping tests. The state of `problem` is the best one at the end.
Minimum Minimize(const SolveOptions& options, const ProgressCallback& progress,
                 LeastSquares* problem);

}  // namespace bundle::fused

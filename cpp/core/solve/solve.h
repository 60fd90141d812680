#pragma once

#include <functional>
#include <vector>

#include "core/problem/problem_view.h"
#include "core/solve/options.h"
#include "core/solve/summary.h"

namespace bundle {

/// Called after each iteration; false stops the solve, which then keeps the best state. So does an
/// InterruptionScope, within an iteration; before the first evaluation is complete there is nothing
/// to keep, and Interrupted is thrown.
using ProgressCallback = std::function<bool(const IterationRecord&)>;

/// What every solve tells of itself.
struct SolveRecord {
  SolveSummary summary;
  std::vector<IterationRecord> iterations;
  double build_time_in_seconds = 0;  ///< outside the solver
  double solve_time_in_seconds = 0;  ///< inside it
};

struct SolveOutput : SolveRecord {
  std::vector<double> cam_from_world;  ///< as in ProblemView
  std::vector<double> camera_params;   ///< as in ProblemView
  std::vector<double> points;          ///< as in ProblemView
};

}  // namespace bundle

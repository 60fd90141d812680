#pragma once

/// Solves a window by Levenberg-Marquardt within limits of iterations and time.

#include <string>
#include <vector>

#include "core/interface/summary.h"
#include "core/window/window.h"

namespace bundle {

struct WindowSolveOptions {
  int max_num_iterations = 8;
  /// Seconds; no iteration begins after this time. The best state so far is kept.
  double time_budget = 0.04;
  double function_tolerance = 1e-6;
  double gradient_tolerance = 1e-10;
  double parameter_tolerance = 1e-8;
  bool spectrum = false;    ///< compute the spectrum of the reduced normal equations
  bool covariance = false;  ///< compute the covariance of the last state
  bool expected_imu_cost = false;
  /// Covariance with the first position and yaw constant, if no prior fixes them.
  bool fix_gauge = false;
};

struct WindowOutput {
  WindowState state;
  WindowCosts before, after;
  std::string termination_type, message;
  bool out_of_time = false, interrupted = false;
  int num_rejected = 0;
  double fill_ratio = 1;  ///< WindowStructure::fill_ratio
  std::vector<IterationRecord> iterations;
  double linearization_time = 0, linear_solver_time = 0, candidate_time = 0, total_time = 0;
  std::vector<double>
      spectrum;  ///< ascending, with the diagonal scaled to 1; empty unless requested
  std::vector<double> residual_norms;  ///< norms per observation, in sigmas, without the loss
  std::vector<double> covariance;      ///< 15 x 15; empty if not available
  double expected_imu_cost = 0;        ///< NaN if not available
};

/// Throws InputError if a residual has no value at the start.
WindowOutput SolveWindow(const WindowView& view, const WindowSolveOptions& options,
                         const ProgressCallback& progress);

}  // namespace bundle

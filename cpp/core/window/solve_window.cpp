#include "core/window/solve_window.h"

#include <limits>
#include <utility>

#include "core/error.h"
#include "core/minimize/trust_region.h"
#include "core/window/window_problem.h"

namespace bundle {

WindowOutput SolveWindow(const WindowView& view, const WindowSolveOptions& options,
                         const ProgressCallback& progress) {
  const Stopwatch time;
  WindowOutput output;
  WindowProblem problem(view);
  output.before = CostsOfWindow(view, WindowState(view));
  if (!(output.before.Total() < std::numeric_limits<double>::infinity())) {
    throw InputError(
        "window: expected landmarks in front of the cameras that see them, and finite "
        "residuals");
  }
  SolveOptions solve_options;
  solve_options.max_num_iterations = options.max_num_iterations;
  solve_options.function_tolerance = options.function_tolerance;
  solve_options.gradient_tolerance = options.gradient_tolerance;
  solve_options.parameter_tolerance = options.parameter_tolerance;
  const ProgressCallback within_budget = [&](const IterationRecord& record) {
    if (progress && !progress(record)) return false;
    output.out_of_time = time.seconds() > options.time_budget;
    return !output.out_of_time;
  };
  MinimizerSummary minimum = Minimize(solve_options, within_budget, &problem);
  output.state = problem.x();
  output.after = problem.costs();
  output.termination_type = minimum.termination_type;
  output.message = std::move(minimum.message);
  output.interrupted = minimum.interrupted && !output.out_of_time;
  output.fill_ratio = problem.fill_ratio();
  output.num_rejected = minimum.num_unsuccessful_steps;
  output.iterations = std::move(minimum.iterations);
  output.linearization_time = minimum.linearization_time_in_seconds;
  output.linear_solver_time = minimum.solve_time_in_seconds;
  output.candidate_time = minimum.candidate_time_in_seconds;
  output.residual_norms = VisualResidualNorms(view, output.state);
  if (options.covariance) output.covariance = problem.CovarianceOfLastState(options.fix_gauge);
  if (options.expected_imu_cost) {
    output.expected_imu_cost = problem.ExpectedImuCost(options.fix_gauge);
  }
  if (options.spectrum) output.spectrum = problem.ReducedSpectrum();
  output.total_time = time.seconds();
  return output;
}

}  // namespace bundle

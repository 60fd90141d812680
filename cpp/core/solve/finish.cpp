#include "core/solve/finish.h"

#include <cmath>
#include <utility>

#include "core/solve/block_patterns.h"
#include "core/solve/check_solution.h"
#include "core/solve/convergence_watch.h"
#include "core/solve/lost_observations.h"
#include "core/solve/plausibility.h"

namespace bundle {
namespace {

/// A gradient that is no number is below every tolerance for Ceres, which then has converged.
void FailIfNotFinite(SolveOutput* output) {
  SolveSummary& summary = output->summary;
  if (summary.termination_type == "FAILURE" || output->iterations.empty()) return;
  const double gradient = output->iterations.back().gradient_max_norm;
  const bool is_finite = std::isfinite(summary.final_cost) && std::isfinite(gradient);
  if (is_finite) return;
  summary.termination_type = "FAILURE";
  summary.message = std::isfinite(summary.final_cost)
                        ? "Residual and Jacobian evaluation failed: the gradient is not finite."
                        : "Residual and Jacobian evaluation failed: the cost is not finite.";
}

}  // namespace

void FinishSolve(const ProblemView& problem, const ParameterLayout& layout,
                 const CameraStates& states, const SolveOptions& options,
                 std::vector<Warning> warnings, int64_t num_held, SolveOutput* output) {
  SolveSummary& summary = output->summary;
  summary.warnings = std::move(warnings);
  FailIfNotFinite(output);
  summary.num_information_nonzeros = NumInformationNonzeros(problem, layout);
  const auto warn = [&summary](WarningKind kind, std::string text) {
    Warn(kind, std::move(text), &summary.warnings);
  };
  if (summary.termination_type == "FAILURE" || !std::isfinite(summary.initial_cost)) {
    summary.is_solution_usable = false;
    warn(WarningKind::kResidualNotFinite, FindOverflow(problem, options.cheirality));
  }
  warn(WarningKind::kSuspiciousSteps, WatchConvergence(output->iterations));
  warn(WarningKind::kSuspiciousJacobian,
       CheckSolution(problem, layout, states, output->points, options.cheirality));
  const bool is_rejected = RejectImpossibleSolution(problem, output);
  if (num_held > 0 && !is_rejected)
    JudgeLostObservations(problem, layout, options, num_held, output);
}

}  // namespace bundle

#include "core/ceres/summarize.h"

namespace bundle {

SolveSummary Summarize(const ceres::Solver::Summary& summary, double fixed_cost) {
  SolveSummary result;
  result.initial_cost = summary.initial_cost + fixed_cost;
  result.final_cost = summary.final_cost + fixed_cost;
  result.fixed_cost = summary.fixed_cost + fixed_cost;
  result.termination_type = ceres::TerminationTypeToString(summary.termination_type);
  result.message = summary.message;
  result.is_solution_usable = summary.IsSolutionUsable();
  result.num_successful_steps = summary.num_successful_steps;
  result.num_unsuccessful_steps = summary.num_unsuccessful_steps;
  result.num_parameter_blocks = summary.num_parameter_blocks;
  result.num_parameters = summary.num_parameters;
  result.num_residual_blocks = summary.num_residual_blocks;
  result.num_residuals = summary.num_residuals;
  result.num_parameter_blocks_reduced = summary.num_parameter_blocks_reduced;
  result.num_parameters_reduced = summary.num_parameters_reduced;
  result.num_residual_blocks_reduced = summary.num_residual_blocks_reduced;
  result.num_residuals_reduced = summary.num_residuals_reduced;
  result.trust_region_strategy_type =
      ceres::TrustRegionStrategyTypeToString(summary.trust_region_strategy_type);
  result.dogleg_type = ceres::DoglegTypeToString(summary.dogleg_type);
  result.linear_solver_type_given =
      ceres::LinearSolverTypeToString(summary.linear_solver_type_given);
  result.linear_solver_type_used = ceres::LinearSolverTypeToString(summary.linear_solver_type_used);
  result.linear_solver_ordering_given = summary.linear_solver_ordering_given;
  result.linear_solver_ordering_used = summary.linear_solver_ordering_used;
  result.schur_structure_given = summary.schur_structure_given;
  result.schur_structure_used = summary.schur_structure_used;
  result.preconditioner_type_given =
      ceres::PreconditionerTypeToString(summary.preconditioner_type_given);
  result.preconditioner_type_used =
      ceres::PreconditionerTypeToString(summary.preconditioner_type_used);
  result.dense_linear_algebra_library_type =
      ceres::DenseLinearAlgebraLibraryTypeToString(summary.dense_linear_algebra_library_type);
  result.sparse_linear_algebra_library_type =
      ceres::SparseLinearAlgebraLibraryTypeToString(summary.sparse_linear_algebra_library_type);
  result.num_threads_given = summary.num_threads_given;
  result.num_threads_used = summary.num_threads_used;
  result.preprocessor_time_in_seconds = summary.preprocessor_time_in_seconds;
  result.residual_evaluation_time_in_seconds = summary.residual_evaluation_time_in_seconds;
  result.jacobian_evaluation_time_in_seconds = summary.jacobian_evaluation_time_in_seconds;
  result.linear_solver_time_in_seconds = summary.linear_solver_time_in_seconds;
  result.minimizer_time_in_seconds = summary.minimizer_time_in_seconds;
  result.postprocessor_time_in_seconds = summary.postprocessor_time_in_seconds;
  result.total_time_in_seconds = summary.total_time_in_seconds;
  result.num_residual_evaluations = summary.num_residual_evaluations;
  result.num_jacobian_evaluations = summary.num_jacobian_evaluations;
  result.num_linear_solves = summary.num_linear_solves;
  return result;
}

std::vector<Warning> FindFallbacks(const ceres::Solver::Summary& summary) {
  std::vector<Warning> result;
  const auto compare = [&result](WarningKind kind, const std::string& what,
                                 const std::string& given, const std::string& used) {
    if (given != used)
      result.push_back({kind, "Ceres replaced " + what + given + " by " + used + "."});
  };
  compare(WarningKind::kSolverReplaced, "",
          ceres::LinearSolverTypeToString(summary.linear_solver_type_given),
          ceres::LinearSolverTypeToString(summary.linear_solver_type_used));
  // The others carry a preconditioner along that nobody reads.
  const bool is_iterative = summary.linear_solver_type_used == ceres::ITERATIVE_SCHUR ||
                            summary.linear_solver_type_used == ceres::CGNR;
  if (is_iterative) {
    compare(WarningKind::kPreconditionerReplaced, "the preconditioner ",
            ceres::PreconditionerTypeToString(summary.preconditioner_type_given),
            ceres::PreconditionerTypeToString(summary.preconditioner_type_used));
  }
  return result;
}

IterationRecord ToRecord(const ceres::IterationSummary& iteration, double fixed_cost) {
  IterationRecord record;
  record.iteration = iteration.iteration;
  record.cost = iteration.cost + fixed_cost;
  record.cost_change = iteration.cost_change;
  record.gradient_max_norm = iteration.gradient_max_norm;
  record.step_norm = iteration.step_norm;
  record.relative_decrease = iteration.relative_decrease;
  record.trust_region_radius = iteration.trust_region_radius;
  record.linear_solver_iterations = iteration.linear_solver_iterations;
  record.step_is_successful = iteration.step_is_successful;
  record.iteration_time_in_seconds = iteration.iteration_time_in_seconds;
  record.cumulative_time_in_seconds = iteration.cumulative_time_in_seconds;
  return record;
}

}  // namespace bundle

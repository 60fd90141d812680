#include "core/ceres/summarize.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <new>
#include <string>
#include <utility>
#include <vector>

#include "core/ceres/translate_options.h"
#include "core/interface/summary.h"
#include "core/model/coupled_blocks.h"
#include "core/parallel/thread_pool.h"
#include "core/symbolic/block_pattern.h"
#include "core/symbolic/factor_counts.h"

namespace bundle {

namespace {

constexpr int64_t kPointSize = 3;

bool IsSchur(ceres::LinearSolverType type) {
  return type == ceres::DENSE_SCHUR || type == ceres::SPARSE_SCHUR;
}

/// Remaining columns when the images' blocks are eliminated (translate_options.cpp).
int64_t NumColumnsWithoutImages(const ParameterLayout& layout) {
  int64_t num_columns = kPointSize * layout.num_free_points();
  for (const int block : layout.BlocksBesideFirst()) num_columns += layout.blocks()[block].size;
  return num_columns;
}

int64_t NumColumns(const ParameterLayout& layout, EliminationOrdering ordering, bool is_schur) {
  if (!is_schur) return kPointSize * layout.num_free_points() + layout.state_size();
  return ordering == EliminationOrdering::kPointsFirst ? layout.state_size()
                                                       : NumColumnsWithoutImages(layout);
}

void SetDense(bool is_schur, FactorSummary* result) {
  const int64_t n = *result->num_columns;
  if (is_schur) result->num_reduced_nonzeros = n * n;
  result->num_nonzeros = n * (n + 1) / 2;
  result->flops = DenseFactorFlops(static_cast<double>(n));
  result->ordering = "natural";
  result->symbolic_time_in_seconds = 0;
}

void SetSparse(const AdjustmentProblem& problem, const ParameterLayout& layout, bool is_schur,
               FactorSummary* result) {
  const Stopwatch symbolic;
  const OrderedPattern ordered =
      is_schur ? OrderReducedPattern(problem, layout) : OrderFullPattern(problem, layout);
  const FactorCounts counts = CountFactor(ordered.pattern, ordered.order);
  if (is_schur) result->num_reduced_nonzeros = std::llround(NumNonzeros(ordered.pattern));
  result->num_nonzeros = std::llround(counts.entries);
  result->flops = counts.flops;
  result->ordering = ordered.points_first ? "points first, amd" : "amd";
  result->symbolic_time_in_seconds = symbolic.seconds();
}

}  // namespace

FactorSummary CountCeresFactor(const AdjustmentProblem& problem, const ParameterLayout& layout,
                               EliminationOrdering ordering, ceres::LinearSolverType type) {
  FactorSummary result;
  const bool is_schur = IsSchur(type);
  const bool is_dense = type == ceres::DENSE_SCHUR || type == ceres::DENSE_NORMAL_CHOLESKY;
  if (!is_schur && !is_dense && type != ceres::SPARSE_NORMAL_CHOLESKY) return result;
  // If Ceres chose the blocks to eliminate, it reports their number, but not which.
  const bool is_known = ordering != EliminationOrdering::kAutomatic &&
                        !NothingToEliminate(ordering, layout) &&
                        !FactorsCoupleFirstGroup(ordering, problem, layout);
  if (is_schur && !is_known) return result;

  result.num_columns = NumColumns(layout, ordering, is_schur);
  if (is_dense) {
    SetDense(is_schur, &result);
    return result;
  }
  // Eliminating an image couples all points that it sees. Finding these pairs of points would take
  // far too long.
  if (is_schur && ordering == EliminationOrdering::kCamerasFirst) return result;
  try {
    SetSparse(problem, layout, is_schur, &result);
  } catch (const std::bad_alloc&) {
    // The solve is complete, and its result matters more than these numbers.
  }
  return result;
}

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
  // Other linear solvers have a preconditioner option that Ceres does not use.
  const bool is_iterative = summary.linear_solver_type_used == ceres::ITERATIVE_SCHUR ||
                            summary.linear_solver_type_used == ceres::CGNR;
  if (is_iterative) {
    compare(WarningKind::kPreconditionerReplaced, "the preconditioner ",
            ceres::PreconditionerTypeToString(summary.preconditioner_type_given),
            ceres::PreconditionerTypeToString(summary.preconditioner_type_used));
  }
  return result;
}

IterationRecord ToRecord(const ceres::IterationSummary& iteration, double fixed_cost,
                         const StepLengths& lengths) {
  IterationRecord record;
  record.iteration = iteration.iteration;
  record.cost = iteration.cost + fixed_cost;
  record.cost_change = iteration.cost_change;
  record.gradient_max_norm = iteration.gradient_max_norm;
  record.step_norm = lengths.Of(iteration);
  record.relative_decrease = iteration.relative_decrease;
  record.trust_region_radius = iteration.trust_region_radius;
  record.linear_solver_iterations = iteration.linear_solver_iterations;
  record.step_is_successful = iteration.step_is_successful;
  record.iteration_time_in_seconds = iteration.iteration_time_in_seconds;
  record.cumulative_time_in_seconds = iteration.cumulative_time_in_seconds;
  return record;
}

ceres::CallbackReturnType ReportProgress::operator()(const ceres::IterationSummary& iteration) {
  // An abandoned step is not reported.
  if (abandoned_) return ceres::SOLVER_TERMINATE_SUCCESSFULLY;
  const bool goes_on = !progress_ || progress_(ToRecord(iteration, fixed_cost_, lengths_));
  if (goes_on && !InterruptionRequested()) return ceres::SOLVER_CONTINUE;
  interrupted_ = true;
  return ceres::SOLVER_TERMINATE_SUCCESSFULLY;
}

void PutBefore(const ceres::Solver::Summary& first, bool repeats, ceres::Solver::Summary* next) {
  const ceres::IterationSummary& last = first.iterations.back();
  std::vector<ceres::IterationSummary> iterations = first.iterations;
  for (ceres::IterationSummary& iteration : next->iterations) {
    if (repeats && iteration.iteration == 0) {
      --next->num_successful_steps;
      continue;
    }
    iteration.iteration += last.iteration + (repeats ? 0 : 1);
    iteration.cumulative_time_in_seconds += last.cumulative_time_in_seconds;
    iterations.push_back(iteration);
  }
  next->iterations = std::move(iterations);
  next->initial_cost = first.initial_cost;
  const auto add = [&](auto member) { next->*member += first.*member; };
  using Summary = ceres::Solver::Summary;
  for (const auto count : {&Summary::num_successful_steps, &Summary::num_unsuccessful_steps,
                           &Summary::num_residual_evaluations, &Summary::num_jacobian_evaluations,
                           &Summary::num_linear_solves}) {
    add(count);
  }
  for (const auto time :
       {&Summary::preprocessor_time_in_seconds, &Summary::minimizer_time_in_seconds,
        &Summary::postprocessor_time_in_seconds, &Summary::total_time_in_seconds,
        &Summary::linear_solver_time_in_seconds, &Summary::residual_evaluation_time_in_seconds,
        &Summary::jacobian_evaluation_time_in_seconds}) {
    add(time);
  }
  if (next->termination_type == ceres::NO_CONVERGENCE) {
    next->message = "Maximum number of iterations reached. Number of iterations: " +
                    std::to_string(next->iterations.back().iteration) + ".";
  }
}

void ForgetAbandonedStep(ceres::Solver::Summary* summary) {
  const auto unfinished = [](const ceres::IterationSummary& iteration) {
    return iteration.iteration > 0 && !(iteration.cost < std::numeric_limits<double>::max());
  };
  if (unfinished(summary->iterations.back())) {
    summary->iterations.pop_back();
    --summary->num_unsuccessful_steps;
  }
  summary->termination_type = ceres::USER_SUCCESS;
  summary->message = "User callback returned SOLVER_TERMINATE_SUCCESSFULLY.";
  summary->final_cost = summary->initial_cost;
  for (const ceres::IterationSummary& iteration : summary->iterations) {
    summary->final_cost = std::min(summary->final_cost, iteration.cost);
  }
}

}  // namespace bundle

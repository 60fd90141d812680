#include "core/solver/summarize_fused.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <string>

#include "core/interface/options.h"
#include "core/prepare/prepare.h"
#include "core/schur/camera_factors.h"
#include "core/sums/communicator.h"

namespace bundle {
namespace {

/// Sizes of a residual with a point, of the point and of the camera blocks, "2,3,9"; "d" for sizes
/// that differ.
std::string SchurStructure(const ParameterLayout& layout, bool has_other_rows) {
  const std::vector<CameraBlock>& blocks = layout.blocks();
  const bool equal = std::all_of(blocks.begin(), blocks.end(), [&](const CameraBlock& block) {
    return block.size == blocks.front().size;
  });
  return std::string(has_other_rows ? "d" : "2") + ",3," +
         (equal ? std::to_string(blocks.front().size) : "d");
}

void SetLinearSolver(const SolveOptions& options, SolveSummary* result) {
  result->linear_solver_type_used = result->linear_solver_type_given;
  // Keeps Ceres' default if there is no preconditioner.
  if (IsIterative(options.linear_solver_type)) {
    result->preconditioner_type_given =
        UpperName(options.preconditioner_type, kPreconditionerTypes);
    result->preconditioner_type_used = result->preconditioner_type_given;
  }
  result->sparse_linear_algebra_library_type = "SUITE_SPARSE";
}

}  // namespace

void SummarizeChoices(const SolveOptions& options, SolveSummary* result) {
  const TrustRegionStrategy strategy = options.trust_region_strategy_type;
  result->trust_region_strategy_type =
      strategy == TrustRegionStrategy::kLevenbergMarquardt ? "LEVENBERG_MARQUARDT" : "DOGLEG";
  result->dogleg_type =
      strategy == TrustRegionStrategy::kSubspaceDogleg ? "SUBSPACE_DOGLEG" : "TRADITIONAL_DOGLEG";
  result->linear_solver_type_given = UpperName(options.linear_solver_type, kLinearSolverTypes);
  result->preconditioner_type_given = result->preconditioner_type_used = "JACOBI";
  result->dense_linear_algebra_library_type = "LAPACK";
  result->num_threads_given = result->num_threads_used = options.num_threads;
}

void SummarizeMinimum(const MinimizerSummary& minimum, double fixed_cost, Counted counted,
                      SolveSummary* result) {
  result->fixed_cost = fixed_cost;
  if (!minimum.iterations.empty()) {  // otherwise the start could not be evaluated
    double least = minimum.iterations.front().cost;
    for (const IterationRecord& record : minimum.iterations) {
      if (counted == Counted::kAccepted && !record.step_is_successful) continue;
      least = std::min(least, record.cost);
    }
    least = CostOfWhatCounts(minimum.iterations).value_or(least);
    if (minimum.returned_to_best) least = minimum.best_cost;
    result->initial_cost = minimum.iterations.front().cost + fixed_cost;
    result->final_cost = least + fixed_cost;
  }
  result->residual_evaluation_time_in_seconds = minimum.candidate_time_in_seconds;
  result->jacobian_evaluation_time_in_seconds = minimum.linearization_time_in_seconds;
  result->linear_solver_time_in_seconds = minimum.solve_time_in_seconds;
  result->num_residual_evaluations = minimum.num_candidates;
  result->num_jacobian_evaluations = minimum.num_linearizations;
  result->num_linear_solves = minimum.num_linear_solves;
  result->termination_type = minimum.termination_type;
  result->message = minimum.message;
  result->is_solution_usable = minimum.termination_type != "FAILURE";
  result->interrupted = minimum.interrupted;
  result->untaken_decrease = minimum.untaken_decrease;
  result->distance_in_sigmas = minimum.distance_in_sigmas;
  result->largest_camera_step_in_sigmas = minimum.largest_camera_step_in_sigmas;
  result->num_successful_steps = minimum.num_successful_steps;
  result->num_unsuccessful_steps = minimum.num_unsuccessful_steps;
}

void SetSizes(int num_blocks, int num_parameters, int64_t num_residual_blocks,
              int64_t num_residuals, SolveSummary* result) {
  result->num_parameter_blocks = result->num_parameter_blocks_reduced = num_blocks;
  result->num_parameters = result->num_parameters_reduced = num_parameters;
  result->num_residual_blocks = result->num_residual_blocks_reduced =
      static_cast<int>(num_residual_blocks);
  result->num_residuals = result->num_residuals_reduced = static_cast<int>(num_residuals);
}

SolveSummary Summarize(const SolveOptions& options, const ParameterLayout& layout,
                       const SchurProblem& schur, const MinimizerSummary& minimum,
                       const SolveTimes& times) {
  SolveSummary result;
  const CameraFactors& factors = schur.factors();
  Communicator* const communicator = schur.setup().problem.division.communicator;
  const int64_t num_observations = SumOverRanks(communicator, schur.num_active_observations());
  const auto num_points =
      static_cast<int>(SumOverRanks(communicator, int64_t{layout.num_free_points()}));
  const int64_t num_factors = SumOverRanks(communicator, int64_t{factors.num_factors()});
  const int64_t num_factor_residuals = SumOverRanks(communicator, int64_t{factors.num_residuals()});
  const bool has_other_rows = SumOverRanks(communicator, int64_t{factors.has_other_rows()}) > 0;
  const auto num_blocks = static_cast<int>(layout.blocks().size());
  SummarizeChoices(options, &result);
  SummarizeMinimum(minimum, schur.fixed_cost(), Counted::kAll, &result);
  result.held_cost = schur.held_cost();
  // The problem never includes constant parameters.
  SetSizes(num_points + num_blocks, 3 * num_points + layout.state_size(),
           num_observations + num_factors, 2 * num_observations + num_factor_residuals, &result);
  SetLinearSolver(options, &result);
  result.linear_solver_ordering_given = {num_points, num_blocks};
  result.linear_solver_ordering_used = result.linear_solver_ordering_given;
  result.schur_structure_given = SchurStructure(layout, has_other_rows);
  result.schur_structure_used = result.schur_structure_given;
  result.preprocessor_time_in_seconds = times.preprocessor;
  result.minimizer_time_in_seconds = times.minimizer;
  result.postprocessor_time_in_seconds = times.postprocessor;
  result.total_time_in_seconds = times.total;
  result.instruction_set = schur.instruction_set();
  return result;
}

FactorSummary SummarizeFactor(const BlockStructure& structure, const FactorStatistics& statistics,
                              double symbolic_time_in_seconds) {
  FactorSummary result;
  int64_t num_nonzeros = 0;
  for (int j = 0; j < structure.num_blocks(); ++j) {
    for (int64_t e = structure.column_begin[j]; e < structure.column_begin[j + 1]; ++e) {
      const int i = structure.row_block[e];
      num_nonzeros += int64_t{i == j ? 1 : 2} * structure.block_size(i) * structure.block_size(j);
    }
  }
  result.num_reduced_nonzeros = num_nonzeros;
  result.symbolic_time_in_seconds = symbolic_time_in_seconds;
  if (statistics.ordering.empty()) return result;
  result.num_columns = structure.num_columns();
  result.num_nonzeros = std::llround(statistics.entries);
  result.flops = statistics.flops;
  result.ordering = statistics.ordering;
  return result;
}

std::string FindSwollenFactor(const FactorStatistics& statistics) {
  // At most a fifth of the values of a panel are explicit zeros (supernodes.cpp); if there are
  // more, the predicted count was wrong.
  constexpr double kFar = 1.5;
  if (!(statistics.stored > kFar * statistics.predicted)) return "";
  char text[160];
  std::snprintf(text, sizeof(text),
                "The factor has %.4g entries, %.1f times the %.4g that were predicted for its "
                "ordering, ",
                statistics.stored, statistics.stored / statistics.predicted, statistics.predicted);
  return text + statistics.ordering + ".";
}

}  // namespace bundle

#pragma once

/// Summaries of solves by our own solvers, under the names of Ceres.

#include <cstdint>
#include <string>

#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/linear/block_structure.h"
#include "core/linear/linear_solver.h"
#include "core/minimize/trust_region.h"
#include "core/model/parameter_layout.h"
#include "core/schur/schur_problem.h"

namespace bundle {

/// Wall times in seconds.
struct SolveTimes {
  double preprocessor = 0;
  double minimizer = 0;
  double postprocessor = 0;
  double total = 0;
};

/// Summary of a minimisation as in ceres::Solver::Summary. `options` contains no kAuto.
///
/// Three of Ceres' times have a different meaning here, because linearisation and elimination are
/// one pass. The Jacobian evaluation includes the elimination of the points, the linear solver's
/// time is that of the reduced camera system alone, and the residual evaluation includes the
/// back-substitution.
SolveSummary Summarize(const SolveOptions& options, const ParameterLayout& layout,
                       const SchurProblem& schur, const MinimizerSummary& minimum,
                       const SolveTimes& times);

/// Steps whose minimum cost is the final cost: all steps, as in Ceres, or the accepted ones. If
/// steps change the set of observations that count, costs are sums over different observations.
/// Then the final cost is that of the last accepted step.
enum class Counted { kAll, kAccepted };

/// Common parts of the summaries of our own solvers: options, the minimum (without the constant
/// `fixed_cost`), and sizes.
void SummarizeChoices(const SolveOptions& options, SolveSummary* result);
void SummarizeMinimum(const MinimizerSummary& minimum, double fixed_cost, Counted counted,
                      SolveSummary* result);
void SetSizes(int num_blocks, int num_parameters, int64_t num_residual_blocks,
              int64_t num_residuals, SolveSummary* result);

/// Summary of the factor of a solver, from its structure and statistics.
FactorSummary SummarizeFactor(const BlockStructure& structure, const FactorStatistics& statistics,
                              double symbolic_time_in_seconds);

/// Returns a message if the factor takes far more than its ordering predicted; otherwise "".
std::string FindSwollenFactor(const FactorStatistics& statistics);

}  // namespace bundle

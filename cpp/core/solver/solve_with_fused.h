#pragma once

#include <string>

#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/linear/block_structure.h"
#include "core/linear/linear_solver.h"
#include "core/minimize/trust_region.h"
#include "core/model/parameter_layout.h"
#include "core/prepare/prepare.h"
#include "core/schur/schur_problem.h"

namespace bundle::fused {

/// Bundle adjustment by the fused backend of what PrepareSolve made of the problem. The options and
/// the layout are such that ChooseBackend takes them.
///
/// Throws InputError if options exclude each other or the dense matrices of the solver would not
/// fit into memory. Anything else that keeps the solve from converging is in the summary.
SolveOutput SolveWithFused(const ProblemView& problem, const SolveOptions& options,
                           PreparedSolve prepared, const ProgressCallback& progress);

/// Wall times in seconds.
struct SolveTimes {
  double preprocessor = 0;
  double minimizer = 0;
  double postprocessor = 0;
  double total = 0;
};

/// A minimum as ceres::Solver::Summary tells it. `options` has nothing left to choose.
///
/// Three of Ceres' times name other work here, because linearisation and elimination are one pass:
/// the Jacobian evaluation includes the elimination of the points, the linear solver's time is that
/// of the reduced camera system alone, and the residual evaluation includes the back-substitution.
SolveSummary Summarize(const SolveOptions& options, const ParameterLayout& layout,
                       const SchurProblem& schur, const MinimizerSummary& minimum,
                       const SolveTimes& times);

/// `structure` as its solver wants it, with that solver's statistics.
FactorSummary SummarizeFactor(const BlockStructure& structure, const FactorStatistics& statistics,
                              double symbolic_time_in_seconds);

/// One sentence if the factor takes far more than its ordering predicted; else "".
std::string FindSwollenFactor(const FactorStatistics& statistics);

}  // namespace bundle::fused

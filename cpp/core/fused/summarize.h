#pragma once

#include <string>

#include "core/fused/eliminate/schur_problem.h"
#include "core/fused/minimize/trust_region.h"
#include "core/fused/reduced/reduced_solver.h"
#include "core/fused/reduced/reduced_system.h"
#include "core/solve/options.h"
#include "core/solve/parameter_layout.h"
#include "core/solve/summary.h"

namespace bundle::fused {

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
                       const SchurProblem& schur, const Minimum& minimum, const SolveTimes& times);

/// `structure` as its solver wants it, with that solver's statistics.
FactorSummary SummarizeFactor(const ReducedStructure& structure, const FactorStatistics& statistics,
                              double symbolic_time_in_seconds);

/// One sentence if the factor takes far more than its ordering predicted; else "".
std::string FindSwollenFactor(const FactorStatistics& statistics);

}  // namespace bundle::fused

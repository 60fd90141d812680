#pragma once

/// Solves by Ceres: bundle adjustment (solve_with_ceres.cpp) and factor graphs (solve_graph.cpp).

#include <functional>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/minimize/sigma_rule.h"
#include "core/prepare/prepare.h"

namespace bundle {

/// Measures the Newton decrements at the values of a problem; empty: they are not measured.
using MeasureDecrement = std::function<NewtonDecrement(const AdjustmentProblem&)>;

/// Bundle adjustment by Ceres. `prepared` is the output of PrepareSolve for the problem.
///
/// Throws InputError if options exclude each other or the dense matrices of the solver would not
/// fit into memory. Other reasons why a solve does not converge are in the summary.
SolveOutput SolveWithCeres(const AdjustmentProblem& problem, const SolveOptions& options,
                           PreparedSolve prepared, const ProgressCallback& progress,
                           const MeasureDecrement& measure);

/// "2.1.0"
const char* CeresVersion();

}  // namespace bundle

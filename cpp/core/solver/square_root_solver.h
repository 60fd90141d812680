#pragma once

/// Factor graphs without normal equations: steps by a QR factorisation of the whitened Jacobian.

#include "core/ceres/solve_graph.h"
#include "core/graph/factor_graph.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"

namespace bundle {

/// SolveGraph (ceres/solve_with_ceres.h) without normal equations. Of the options count trust
/// region and when to stop. Throws InputError for bounds, which it does not know.
GraphOutput SolveGraphBySquareRoot(const FactorGraph& graph, const SolveOptions& options,
                                   const ProgressCallback& progress);

}  // namespace bundle

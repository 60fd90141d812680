#pragma once

/// Factor graphs without normal equations: steps by a QR factorisation of the whitened Jacobian.

#include "core/ceres/solve_graph.h"
#include "core/graph/factor_graph.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"

namespace bundle {

/// Same as SolveGraph (ceres/solve_graph.h), without normal equations. Uses the trust region and
/// the stopping rules of the options. Throws InputError for bounds, which are not supported.
GraphOutput SolveGraphBySquareRoot(const FactorGraph& graph, const SolveOptions& options,
                                   const ProgressCallback& progress);

}  // namespace bundle

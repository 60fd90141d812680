#pragma once

/// Factor graphs without normal equations: steps by a QR factorisation of the whitened Jacobian.

#include "core/ceres/solve_with_ceres.h"
#include "core/graph/factor_graph.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"

namespace bundle {

/// Of J S, the free columns of a graph's Jacobian scaled to norm 1, which is what normal equations
/// square whatever the units.
struct JacobianConditioning {
  double max_singular_value = 0;
  double min_singular_value = 0;  ///< 0 where the columns depend on each other
  int num_columns = 0;
  int rank = 0;
};

/// By QR factorisation, power iteration on J^T J and inverse iteration with R^T R: both singular
/// values to a few percent. Throws InputError where nothing is free.
JacobianConditioning EstimateConditioning(const FactorGraph& graph);

/// SolveGraph (ceres/solve_with_ceres.h) without normal equations. Of the options count trust
/// region and when to stop. Throws InputError for bounds, which it does not know.
GraphOutput SolveGraphBySquareRoot(const FactorGraph& graph, const SolveOptions& options,
                                   const ProgressCallback& progress);

}  // namespace bundle

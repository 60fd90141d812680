#pragma once

/// Condition of the Jacobian of a factor graph: the digits that normal equations would lose.

#include <vector>

#include "core/graph/factor_graph.h"

namespace bundle {

/// Conditioning of J S, the free columns of a graph's Jacobian scaled to norm 1. Normal equations
/// square it, whatever the units.
struct JacobianConditioning {
  double max_singular_value = 0;
  double min_singular_value = 0;  ///< 0 where the columns depend on each other
  int num_columns = 0;
  /// The variable of each column that depends on others: num_columns less the rank of them.
  std::vector<int> dependent;
};

/// Estimates both singular values to a few percent, by QR factorisation, power iteration on J^T J
/// and inverse iteration with R^T R. Throws InputError where nothing is free.
JacobianConditioning EstimateConditioning(const FactorGraph& graph);

}  // namespace bundle

#pragma once

/// Condition of the Jacobian of a factor graph: a measure of the digits lost by normal equations.

#include <vector>

#include "core/graph/factor_graph.h"

namespace bundle {

/// Conditioning of J S, the free columns of a graph's Jacobian scaled to norm 1. It is independent
/// of units. Normal equations square it.
struct JacobianConditioning {
  double max_singular_value = 0;
  double min_singular_value = 0;  ///< 0 if the columns are linearly dependent
  int num_columns = 0;
  /// The variable of each column that depends on other columns; there are num_columns minus rank of
  /// them.
  std::vector<int> dependent;
};

/// Estimates both singular values to a few percent, by QR factorisation, power iteration on J^T J
/// and inverse iteration with R^T R. Throws InputError if no variable is free.
JacobianConditioning EstimateConditioning(const FactorGraph& graph);

}  // namespace bundle

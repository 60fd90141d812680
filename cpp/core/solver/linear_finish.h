#pragma once

/// The last step of a graph whose residuals are linear.

#include "core/ceres/solve_graph.h"
#include "core/graph/factor_graph.h"

namespace bundle {

/// Moves a converged solve of a linear graph to its minimum, to rounding, and records that as one
/// more iteration. Any other graph or solve is left as it is.
void FinishLinearGraph(const FactorGraph& graph, GraphOutput* output);

}  // namespace bundle

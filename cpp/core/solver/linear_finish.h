#pragma once

/// The last step of a graph whose residuals are linear.

#include "core/ceres/solve_graph.h"
#include "core/graph/factor_graph.h"

namespace bundle {

/// Moves a converged solve of a linear graph to its minimum, up to rounding, and records this step
/// as one more iteration. Other graphs and solves are not changed.
void FinishLinearGraph(const FactorGraph& graph, GraphOutput* output);

}  // namespace bundle

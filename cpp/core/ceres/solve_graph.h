#pragma once

/// Factor graphs solved and linearised by Ceres.

#include <vector>

#include "core/graph/factor_graph.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"

namespace bundle {

/// Linearises a valid graph (graph/factor_graph.h). Throws the exceptions of factors.
LinearizedGraph LinearizeGraph(const FactorGraph& graph, int num_threads);

struct GraphOutput : SolveRecord {
  std::vector<std::vector<double>> values;  ///< one per variable
};

/// Minimises the cost of a graph by Ceres. Only options of the solver have an effect. Options for
/// reprojection errors (losses, cheirality, refined and fixed parameters) are ignored.
///
/// Throws InputError if the graph is not valid (ValidateGraph) or the options exclude each other;
/// Interrupted if the solve is interrupted before its first result; and the exceptions of factors.
GraphOutput SolveGraph(const FactorGraph& graph, const SolveOptions& options,
                       const ProgressCallback& progress);

}  // namespace bundle

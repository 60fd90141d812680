#pragma once

/// Factor graphs solved and linearised by Ceres.

#include <vector>

#include "core/graph/factor_graph.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"

namespace bundle {

/// Linearises a valid graph (graph/factor_graph.h). Throws what a factor throws.
LinearizedGraph LinearizeGraph(const FactorGraph& graph, int num_threads);

struct GraphOutput : SolveRecord {
  std::vector<std::vector<double>> values;  ///< one per variable
};

/// Minimises the cost of a graph by Ceres. Only the options of the solver count; those of
/// reprojection errors (losses, cheirality, what is refined or held) are ignored.
///
/// Throws InputError if the graph is not valid (ValidateGraph) or the options exclude each other,
/// Interrupted before there is anything to keep, and what a factor throws.
GraphOutput SolveGraph(const FactorGraph& graph, const SolveOptions& options,
                       const ProgressCallback& progress);

}  // namespace bundle

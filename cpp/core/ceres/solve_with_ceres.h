#pragma once

/// Solves by Ceres: bundle adjustment (solve_with_ceres.cpp) and factor graphs (solve_graph.cpp).

#include <vector>

#include "core/graph/factor_graph.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/prepare/prepare.h"

namespace bundle {

/// Bundle adjustment by Ceres of what PrepareSolve made of the problem.
///
/// Throws InputError if options exclude each other or the dense matrices of the solver would not
/// fit into memory. Anything else that keeps the solve from converging is in the summary.
SolveOutput SolveWithCeres(const AdjustmentProblem& problem, const SolveOptions& options,
                           PreparedSolve prepared, const ProgressCallback& progress);

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

/// "2.1.0"
const char* CeresVersion();

}  // namespace bundle

#pragma once

#include "core/graph/factor_graph.h"
#include "core/graph/linearized_graph.h"

namespace bundle {

/// Of a valid graph (graph/factor_graph.h). Throws what a factor throws.
LinearizedGraph LinearizeGraph(const FactorGraph& graph, int num_threads);

}  // namespace bundle

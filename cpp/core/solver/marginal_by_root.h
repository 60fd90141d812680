#pragma once

/// Marginal information by normal equations or, where these lose their digits, by a square root.

#include <vector>

#include "core/graph/factor_graph.h"

namespace bundle {

/// MarginalizeOnto (graph/factor_graph.h), and where that is not certain the same by square roots.
/// Throws InputError, naming the variable, if what is to be eliminated is not determined by its
/// factors.
MarginalInformation FindMarginalInformation(const std::vector<int>& kept,
                                            const std::vector<Block>& blocks,
                                            const LinearizedGraph& graph);

}  // namespace bundle

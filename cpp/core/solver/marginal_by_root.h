#pragma once

/// Marginal information by normal equations or, where these lose their digits, by a square root.

#include <vector>

#include "core/graph/factor_graph.h"

namespace bundle {

/// MarginalizeOnto (graph/factor_graph.h), or the same by square roots if that is not accurate.
/// Throws InputError, with the variable, if an eliminated variable is not determined by its
/// factors.
MarginalInformation FindMarginalInformation(const std::vector<int>& kept,
                                            const std::vector<Block>& blocks,
                                            const LinearizedGraph& graph);

}  // namespace bundle

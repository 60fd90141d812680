#pragma once

/// Marginal information by normal equations or, if these lose too many digits, by a square root.

#include <vector>

#include "core/graph/factor_graph.h"

namespace bundle {

/// Same as MarginalizeOnto (graph/factor_graph.h), or by square roots if that is not accurate.
/// Throws InputError, with the variable, if the factors of an eliminated variable do not determine
/// it.
MarginalInformation FindMarginalInformation(const std::vector<int>& kept,
                                            const std::vector<Block>& blocks,
                                            const LinearizedGraph& graph);

}  // namespace bundle

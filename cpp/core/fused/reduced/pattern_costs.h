#pragma once

/// What the solvers of this folder would make of a pattern of S, for those who only ask.

#include <vector>

#include "core/fused/reduced/reduced_cost.h"
#include "core/symbolic/block_pattern.h"

namespace bundle::fused {

/// Values that the panels of the factor of S hold (supernodes.h), zeros and all, when the blocks
/// are eliminated in this order. Any order will do; it is postordered first, as the solver does.
double CountPanelValues(const BlockPatternView& pattern, const std::vector<int>& order);

/// What `auto` takes, on this machine and now. It does not ask below a few hundred columns.
ReducedChoice ChooseByPattern(const BlockPatternView& pattern, int num_threads);

}  // namespace bundle::fused

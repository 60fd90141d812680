#pragma once

#include <vector>

#include "core/symbolic/block_pattern.h"

namespace bundle::fused {

/// Values that the panels of the factor of S hold (supernodes.h), zeros and all, when the blocks
/// are eliminated in this order. Any order will do; it is postordered first, as the solver does.
double CountPanelValues(const BlockPatternView& pattern, const std::vector<int>& order);

}  // namespace bundle::fused

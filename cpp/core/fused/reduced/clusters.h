#pragma once

#include <vector>

#include "core/fused/reduced/reduced_system.h"

namespace bundle::fused {

/// Groups of strongly coupled blocks, of at most `max_size` each: the cluster of every block, from
/// 0 on. Blocks marked in `alone` are clusters of their own. `values` are those of S.
std::vector<int> ClusterBlocks(const ReducedStructure& structure, const std::vector<double>& values,
                               const std::vector<char>& alone, int max_size);

}  // namespace bundle::fused

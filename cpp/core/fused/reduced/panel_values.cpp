#include "core/fused/reduced/panel_values.h"

#include <cstdint>

#include "core/fused/reduced/reduced_system.h"
#include "core/fused/reduced/supernodes.h"
#include "core/symbolic/factor_counts.h"

namespace bundle::fused {

double CountPanelValues(const BlockPatternView& pattern, const std::vector<int>& order) {
  std::vector<std::vector<int>> columns(pattern.num_blocks);
  for (int j = 0; j < pattern.num_blocks; ++j) {
    columns[j].assign(pattern.row + pattern.column_begin[j],
                      pattern.row + pattern.column_begin[j + 1]);
  }
  const std::vector<int> sizes(pattern.size, pattern.size + pattern.num_blocks);
  const ReducedStructure structure = SparseStructure(sizes, columns);
  std::vector<int> postordered;
  for (const int position : CountFactor(pattern, order).postorder) {
    postordered.push_back(order[position]);
  }
  const Supernodes supernodes = FindSupernodes(Reorder(structure, postordered));
  return static_cast<double>(supernodes.values_begin.back());
}

}  // namespace bundle::fused

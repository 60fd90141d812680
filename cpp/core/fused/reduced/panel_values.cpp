#include "core/fused/reduced/panel_values.h"

#include <cstdint>

#include "core/fused/reduced/fill_ordering.h"
#include "core/fused/reduced/reduced_system.h"
#include "core/fused/reduced/supernodes.h"

namespace bundle::fused {

double CountPanelValues(const BlockPatternView& pattern, const std::vector<int>& order) {
  std::vector<std::vector<int>> columns(pattern.num_blocks);
  for (int j = 0; j < pattern.num_blocks; ++j) {
    columns[j].assign(pattern.row + pattern.column_begin[j],
                      pattern.row + pattern.column_begin[j + 1]);
  }
  const std::vector<int> sizes(pattern.size, pattern.size + pattern.num_blocks);
  const ReducedStructure structure = SparseStructure(sizes, columns);
  const FillOrdering postordered = AnalyzeOrdering(structure, "", order);
  const Supernodes supernodes = FindSupernodes(Reorder(structure, postordered.order));
  return static_cast<double>(supernodes.values_begin.back());
}

}  // namespace bundle::fused

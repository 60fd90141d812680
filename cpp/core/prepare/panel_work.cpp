#include "core/prepare/panel_work.h"

#include <algorithm>
#include <cstdint>

#include "core/linear/block_structure.h"
#include "core/linear/supernodes.h"
#include "core/symbolic/factor_counts.h"

namespace bundle {
namespace {

BlockStructure StructureInOrder(const BlockPatternView& pattern, const std::vector<int>& order) {
  std::vector<int> sizes(pattern.size, pattern.size + pattern.num_blocks);
  std::vector<std::vector<int>> columns(sizes.size());
  for (int j = 0; j < pattern.num_blocks; ++j) {
    columns[j].assign(pattern.row + pattern.column_begin[j],
                      pattern.row + pattern.column_begin[j + 1]);
  }
  std::vector<int> postordered;
  for (const int position : CountFactor(pattern, order).postorder) {
    postordered.push_back(order[position]);
  }
  return Reorder(SparseStructure(sizes, columns), postordered);
}

}  // namespace

PanelWork CountPanelWork(const BlockPatternView& pattern, const std::vector<int>& order) {
  PanelWork work;
  if (pattern.num_blocks == 0) return work;
  const BlockStructure structure = StructureInOrder(pattern, order);
  const Supernodes nodes = FindSupernodes(structure);
  std::vector<int> panel_of(structure.num_blocks());
  for (int s = 0; s < nodes.num_panels(); ++s) {
    std::fill(panel_of.begin() + nodes.first_block[s], panel_of.begin() + nodes.first_block[s + 1],
              s);
  }
  work.panels = nodes.num_panels();
  work.stored = static_cast<double>(nodes.values_begin.back());
  for (int s = 0; s < nodes.num_panels(); ++s) {
    const double width =
        structure.offset[nodes.first_block[s + 1]] - structure.offset[nodes.first_block[s]];
    const double below = nodes.height[s] - width;
    work.factor_flops += width * width * (width / 3 + below);
    const int64_t end = nodes.rows_begin[s + 1];
    for (int64_t first = nodes.rows_begin[s]; first < end;) {
      int64_t last = first;
      double columns = 0;
      while (last < end && panel_of[nodes.row_block[last]] == panel_of[nodes.row_block[first]]) {
        columns += structure.block_size(nodes.row_block[last++]);
      }
      const double rows = nodes.height[s] - nodes.row_in_panel[first];
      work.updates += 1;
      work.products += columns * rows;
      work.reads += rows * width;
      work.update_flops += 2 * columns * rows * width;
      work.row_blocks += static_cast<double>(end - first);
      first = last;
    }
  }
  return work;
}

}  // namespace bundle

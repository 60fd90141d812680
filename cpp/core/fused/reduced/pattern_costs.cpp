#include "core/fused/reduced/pattern_costs.h"

#include "core/fused/reduced/fill_ordering.h"
#include "core/fused/reduced/reduced_system.h"
#include "core/fused/reduced/supernodes.h"
#include "core/solve/memory.h"
#include "core/symbolic/factor_counts.h"

namespace bundle::fused {
namespace {

ReducedStructure StructureOf(const BlockPatternView& pattern) {
  std::vector<std::vector<int>> columns(pattern.num_blocks);
  for (int j = 0; j < pattern.num_blocks; ++j) {
    columns[j].assign(pattern.row + pattern.column_begin[j],
                      pattern.row + pattern.column_begin[j + 1]);
  }
  return SparseStructure({pattern.size, pattern.size + pattern.num_blocks}, columns);
}

}  // namespace

double CountPanelValues(const BlockPatternView& pattern, const std::vector<int>& order) {
  std::vector<int> postordered;
  for (const int position : CountFactor(pattern, order).postorder) {
    postordered.push_back(order[position]);
  }
  const Supernodes supernodes = FindSupernodes(Reorder(StructureOf(pattern), postordered));
  return static_cast<double>(supernodes.values_begin.back());
}

ReducedChoice ChooseByPattern(const BlockPatternView& pattern, int num_threads) {
  const ReducedStructure structure = StructureOf(pattern);
  return ChooseReducedSolver(structure, FindFillOrdering(structure), num_threads,
                             AvailableMemoryBytes());
}

}  // namespace bundle::fused

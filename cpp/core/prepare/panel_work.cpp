#include "core/prepare/panel_work.h"

/// The factorisation goes through the slices of all panels in order, and reads the panels that
/// update a slice (linear/supernodal_cholesky.cpp). Let T(i) be the values that it moves before
/// slice i: those of the earlier slices, and the rows that their updates read. A panel that was
/// last used at slice i, and updates slice j, finds its rows in a cache of C values if
///
///   T(j) - T(i) <= C,
///
/// because a cache that drops the values unused for the longest time still has them (the distance
/// of reuse: Mattson, Gecsei, Slutz, Traiger: Evaluation techniques for storage hierarchies, IBM
/// Systems Journal, 1970). T counts a value again each time it is moved, so that the distance is an
/// upper bound. Between C and 2 C the share of misses grows from 0 to 1.
///
/// Threads take subtrees of panels, those with most flops first, and then share each panel of the
/// top: its updates by slices of columns, its rows below in slices of rows. The busiest thread has
/// the largest sum of subtrees, and of each panel of the top one share in as many as it has slices.
/// Here, an update counts as the flops that take its time.

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <vector>

#include "core/linear/block_structure.h"
#include "core/linear/panel_subtrees.h"
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

/// Slices of all panels, numbered in the order of the factorisation.
struct Slices {
  Slices(const BlockStructure& structure, const Supernodes& nodes)
      : of_block(structure.num_blocks()) {
    for (int s = 0; s < nodes.num_panels(); ++s) {
      const int left = structure.offset[nodes.first_block[s]];
      const int width = structure.offset[nodes.first_block[s + 1]] - left;
      for (int b = nodes.first_block[s]; b < nodes.first_block[s + 1]; ++b) {
        of_block[b] = begin.back() + (structure.offset[b] - left) / kColumnsOfSlice;
      }
      begin.push_back(begin.back() + (width + kColumnsOfSlice - 1) / kColumnsOfSlice);
      for (int left_over = width; left_over > 0; left_over -= kColumnsOfSlice) {
        values.push_back(static_cast<double>(nodes.height[s]) *
                         std::min(left_over, kColumnsOfSlice));
      }
    }
  }

  std::vector<int> begin = {0};  ///< first slice of each panel
  std::vector<int> of_block;
  std::vector<double> values;  ///< per slice
};

struct SliceUpdate {
  int slice;
  double columns, rows, row_blocks;
};

/// Calls visit(update) for the updates by a panel, in the order of their slices.
template <typename Visit>
void ForUpdates(const BlockStructure& structure, const Supernodes& nodes, const Slices& slices,
                int panel, const Visit& visit) {
  const int64_t end = nodes.rows_begin[panel + 1];
  for (int64_t first = nodes.rows_begin[panel]; first < end;) {
    SliceUpdate update{slices.of_block[nodes.row_block[first]], 0,
                       static_cast<double>(nodes.height[panel] - nodes.row_in_panel[first]),
                       static_cast<double>(end - first)};
    for (; first < end && slices.of_block[nodes.row_block[first]] == update.slice; ++first) {
      update.columns += structure.block_size(nodes.row_block[first]);
    }
    visit(update);
  }
}

/// Share of data that a cache does not hold.
double ShareBeyond(double values, double cache_bytes) {
  const double bytes = sizeof(double) * values;
  return std::clamp((bytes - cache_bytes) / cache_bytes, 0.0, 1.0);
}

/// Flops that take as long as an update without any, on machines of the last ten years.
constexpr double kFlopsOfUpdate = 5000;

double BusiestShare(const BlockStructure& structure, const Supernodes& nodes, const Slices& slices,
                    const std::vector<double>& work, int num_threads) {
  const PanelSubtrees trees = FindSubtrees(nodes, structure.offset);
  std::vector<double> busy(num_threads, 0.0);
  for (const int k : trees.order) {
    const auto [first, last] = trees.subtrees[k];
    *std::min_element(busy.begin(), busy.end()) +=
        std::accumulate(work.begin() + first, work.begin() + last, 0.0);
  }
  double busiest = *std::max_element(busy.begin(), busy.end());
  for (const int s : trees.top) {
    busiest += work[s] / std::min(num_threads, slices.begin[s + 1] - slices.begin[s]);
  }
  return busiest / std::accumulate(work.begin(), work.end(), 0.0);
}

}  // namespace

PanelWork CountPanelWork(const BlockPatternView& pattern, const std::vector<int>& order,
                         const CacheSizes& caches, int num_threads) {
  PanelWork work;
  if (pattern.num_blocks == 0) return work;
  const BlockStructure structure = StructureInOrder(pattern, order);
  const Supernodes nodes = FindSupernodes(structure);
  const Slices slices(structure, nodes);
  const auto width_of = [&](int s) -> double {
    return structure.offset[nodes.first_block[s + 1]] - structure.offset[nodes.first_block[s]];
  };
  work.panels = nodes.num_panels();
  work.stored = static_cast<double>(nodes.values_begin.back());

  std::vector<double> moved_before(slices.values.size() + 1, 0.0);
  for (size_t i = 0; i < slices.values.size(); ++i) moved_before[i + 1] = slices.values[i];
  for (int s = 0; s < nodes.num_panels(); ++s) {
    ForUpdates(structure, nodes, slices, s, [&](const SliceUpdate& update) {
      moved_before[update.slice + 1] += update.rows * width_of(s);
    });
  }
  for (size_t i = 0; i < slices.values.size(); ++i) moved_before[i + 1] += moved_before[i];

  std::vector<double> of_panel(nodes.num_panels(), 0.0);  // in flops
  std::vector<int> panel_of_slice(slices.values.size());
  for (int s = 0; s < nodes.num_panels(); ++s) {
    std::fill(panel_of_slice.begin() + slices.begin[s],
              panel_of_slice.begin() + slices.begin[s + 1], s);
  }
  for (int s = 0; s < nodes.num_panels(); ++s) {
    const double width = width_of(s);
    const double factor_flops = width * width * (width / 3 + nodes.height[s] - width);
    work.factor_flops += factor_flops;
    of_panel[s] += factor_flops + kFlopsOfUpdate;
    double last_use = moved_before[slices.begin[s + 1]];
    ForUpdates(structure, nodes, slices, s, [&](const SliceUpdate& update) {
      const double product = update.columns * update.rows, reads = update.rows * width;
      const double distance = moved_before[update.slice] - last_use;
      last_use = moved_before[update.slice];
      work.updates += 1;
      work.products += product;
      work.reads += reads;
      work.near_misses += reads * ShareBeyond(distance, caches.near);
      work.far_misses += reads * ShareBeyond(distance, caches.far);
      work.update_flops += 2 * product * width;
      work.row_blocks += update.row_blocks;
      of_panel[panel_of_slice[update.slice]] += 2 * product * width + kFlopsOfUpdate;
    });
  }
  work.busiest_share = BusiestShare(structure, nodes, slices, of_panel, num_threads);
  return work;
}

}  // namespace bundle

#include "core/linear/supernodes.h"

/// Below its diagonal block, column j of L has the rows of S's column j and those of its children.
/// The children are the columns whose first row below the diagonal is j. Column j includes all rows
/// that a child has below j. So consecutive columns that are child and parent can share a panel,
/// with the rows of the last column. That adds explicit zeros to the earlier columns, which are
/// stored and multiplied.
///
/// Products of wide panels are fast, so storing some zeros saves time. Their number is limited as
/// in CHOLMOD (Chen, Davis, Hager, Rajamanickam: Algorithm 887, 2008), but lower, to save memory. A
/// panel includes the column before it if its share of zeros is then less than 20 % up to 48
/// columns, 5 % up to 192 and 1 % beyond. It may be 70 % where visiting another panel takes longer
/// than the arithmetic on zeros: up to 9 columns, and, while L stays in the cache, up to 2000
/// products of zeros by a column. Unlike in CHOLMOD, the width of a panel is limited, because it
/// also stores the upper triangle of its diagonal blocks. At the root of a tree, where thousands of
/// columns have the same rows, that would be half of its memory.

#include <algorithm>
#include <cstddef>
#include <new>
#include <utility>

namespace bundle {

namespace {

constexpr double kWidestPanel = 256;
constexpr double kFlopsOfAVisit = 2000;
constexpr double kEntriesInCache = 1 << 19;

/// Rows of each block column of L below its diagonal block, ascending.
struct FactorRows {
  std::vector<int64_t> begin = {0};
  std::vector<int> row;

  bool empty(int column) const { return begin[column] == begin[column + 1]; }
  int front(int column) const { return row[begin[column]]; }
};

FactorRows RowsOfFactor(const BlockStructure& structure) {
  const int num_blocks = structure.num_blocks();
  FactorRows rows;
  rows.row.reserve(2 * structure.row_block.size());
  // Lists of the children of a column that is not processed yet.
  std::vector<int> first_child(num_blocks, -1), next_child(num_blocks, -1), seen(num_blocks, -1);
  for (int j = 0; j < num_blocks; ++j) {
    const int64_t begin = rows.begin.back();
    const auto add = [&](int row) {
      if (row <= j || seen[row] == j) return;
      seen[row] = j;
      rows.row.push_back(row);
    };
    for (int64_t e = structure.column_begin[j]; e < structure.column_begin[j + 1]; ++e) {
      add(structure.row_block[e]);
    }
    for (int child = first_child[j]; child >= 0; child = next_child[child]) {
      for (int64_t e = rows.begin[child]; e < rows.begin[child + 1]; ++e) add(rows.row[e]);
    }
    std::sort(rows.row.begin() + begin, rows.row.end());
    rows.begin.push_back(static_cast<int64_t>(rows.row.size()));
    if (rows.empty(j)) continue;
    next_child[j] = first_child[rows.front(j)];
    first_child[rows.front(j)] = j;
  }
  return rows;
}

/// A panel under construction.
struct Panel {
  int first_block, last_block;
  double columns;  ///< scalar
  double below;    ///< scalar rows below the panel
  double zeros;
};

/// The panel that `left` and the following panel `right` would form.
Panel Merged(const Panel& left, const Panel& right) {
  Panel both{left.first_block, right.last_block, left.columns + right.columns, right.below, 0};
  both.zeros = left.zeros + right.zeros + left.columns * (right.columns + right.below - left.below);
  return both;
}

/// Entries of the lower triangle and of the rows below, including zeros.
double Entries(const Panel& panel) {
  return panel.columns * (panel.columns + 1) / 2 + panel.columns * panel.below;
}

bool IsWorthIt(const Panel& panel, bool is_cached) {
  if (panel.columns > kWidestPanel) return false;
  const bool is_small =
      panel.columns <= 9 || (is_cached && panel.zeros * panel.columns <= kFlopsOfAVisit);
  const double share = is_small               ? 0.7
                       : panel.columns <= 48  ? 0.2
                       : panel.columns <= 192 ? 0.05
                                              : 0.01;
  return panel.zeros <= share * Entries(panel);
}

/// Processes columns from the last to the first. Joins a column to the following panel if the zeros
/// are few enough and its parent is in this panel.
std::vector<Panel> FindPanels(const BlockStructure& structure, const FactorRows& rows) {
  std::vector<Panel> reversed;
  const double mean_size =
      structure.num_columns() / static_cast<double>(std::max(structure.num_blocks(), 1));
  const double num_blocks = static_cast<double>(rows.row.size()) + structure.num_blocks();
  const bool is_cached = num_blocks * mean_size * mean_size <= kEntriesInCache;
  for (int j = structure.num_blocks() - 1; j >= 0; --j) {
    Panel panel{j, j + 1, static_cast<double>(structure.block_size(j)), 0, 0};
    for (int64_t e = rows.begin[j]; e < rows.begin[j + 1]; ++e) {
      panel.below += structure.block_size(rows.row[e]);
    }
    if (!reversed.empty() && !rows.empty(j) && rows.front(j) < reversed.back().last_block) {
      const Panel merged = Merged(panel, reversed.back());
      if (IsWorthIt(merged, is_cached)) {
        reversed.back() = merged;
        continue;
      }
    }
    reversed.push_back(panel);
  }
  return {reversed.rbegin(), reversed.rend()};
}

}  // namespace

Supernodes FindSupernodes(const BlockStructure& structure) {
  const FactorRows rows = RowsOfFactor(structure);
  Supernodes result;
  result.first_block.push_back(0);
  result.rows_begin.push_back(0);
  result.values_begin.push_back(0);
  for (const Panel& panel : FindPanels(structure, rows)) {
    const int width = structure.offset[panel.last_block] - structure.offset[panel.first_block];
    int height = width;
    const int last = panel.last_block - 1;
    for (int64_t e = rows.begin[last]; e < rows.begin[last + 1]; ++e) {
      const int row = rows.row[e];
      result.row_block.push_back(row);
      result.row_in_panel.push_back(height);
      height += structure.block_size(row);
    }
    result.first_block.push_back(panel.last_block);
    result.entries += Entries(panel) - panel.zeros;
    result.zeros += panel.zeros;
    result.rows_begin.push_back(static_cast<int64_t>(result.row_block.size()));
    result.height.push_back(height);
    result.values_begin.push_back(result.values_begin.back() +
                                  static_cast<int64_t>(width) * height);
  }
  return result;
}

std::vector<int> PanelOfBlocks(const Supernodes& supernodes) {
  std::vector<int> panel_of(supernodes.first_block.back());
  for (int s = 0; s < supernodes.num_panels(); ++s) {
    std::fill(panel_of.begin() + supernodes.first_block[s],
              panel_of.begin() + supernodes.first_block[s + 1], s);
  }
  return panel_of;
}

BlockStructure PlaceInFactor(const BlockStructure& structure, const Supernodes& supernodes) {
  BlockStructure result = structure;
  result.num_values = supernodes.values_begin.back();
  std::vector<int> position(structure.num_blocks());  // of each block row in the panel
  for (int s = 0; s < supernodes.num_panels(); ++s) {
    const int first = supernodes.first_block[s], last = supernodes.first_block[s + 1];
    const int left = structure.offset[first];
    for (int j = first; j < last; ++j) position[j] = structure.offset[j] - left;
    for (int64_t e = supernodes.rows_begin[s]; e < supernodes.rows_begin[s + 1]; ++e) {
      position[supernodes.row_block[e]] = supernodes.row_in_panel[e];
    }
    for (int j = first; j < last; ++j) {
      result.panel_stride[j] = supernodes.height[s];
      result.panel_begin[j] =
          supernodes.values_begin[s] + static_cast<int64_t>(position[j]) * supernodes.height[s];
      for (int64_t e = structure.column_begin[j]; e < structure.column_begin[j + 1]; ++e) {
        result.row_in_panel[e] = position[structure.row_block[e]];
      }
    }
  }
  return result;
}

}  // namespace bundle

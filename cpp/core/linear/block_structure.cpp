#include "core/linear/block_structure.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <stdexcept>
#include <utility>

namespace bundle {

namespace {

std::vector<int> Offsets(const std::vector<int>& block_sizes) {
  std::vector<int> offset(block_sizes.size() + 1, 0);
  std::partial_sum(block_sizes.begin(), block_sizes.end(), offset.begin() + 1);
  return offset;
}

/// The block rows of each block column, ascending.
struct Columns {
  std::vector<int64_t> begin;
  std::vector<int> row;
};

/// Sorts blocks below the diagonal by columns and in each by rows, with the diagonal. Duplicates
/// count once. `for_blocks(visit)` calls visit(row, column) for each block; it is called twice.
/// Two counting sorts, by rows and then by columns, need no list per column.
template <typename ForBlocks>
Columns SortBlocks(int num_blocks, const ForBlocks& for_blocks) {
  std::vector<int64_t> row_begin(num_blocks + 1, 0);
  for_blocks([&](int row, int /*column*/) { ++row_begin[row + 1]; });
  std::partial_sum(row_begin.begin(), row_begin.end(), row_begin.begin());
  std::vector<int> column_of(row_begin.back());
  std::vector<int64_t> next(row_begin.begin(), row_begin.end() - 1);
  Columns sorted;
  sorted.begin.assign(num_blocks + 1, 0);
  for_blocks([&](int row, int column) {
    column_of[next[row]++] = column;
    ++sorted.begin[column + 1];
  });
  for (int j = 0; j < num_blocks; ++j) sorted.begin[j + 1] += sorted.begin[j] + 1;
  sorted.row.resize(sorted.begin.back());
  std::copy(sorted.begin.begin(), sorted.begin.end() - 1, next.begin());
  for (int i = 0; i < num_blocks; ++i) {
    sorted.row[next[i]++] = i;
    for (int64_t k = row_begin[i]; k < row_begin[i + 1]; ++k) {
      const int column = column_of[k];
      if (sorted.row[next[column] - 1] != i) sorted.row[next[column]++] = i;
    }
  }
  // Closes the gaps of duplicates.
  int64_t end = 0;
  for (int j = 0; j < num_blocks; ++j) {
    const auto first = sorted.row.begin() + sorted.begin[j];
    sorted.begin[j] = end;
    end = std::copy(first, sorted.row.begin() + next[j], sorted.row.begin() + end) -
          sorted.row.begin();
  }
  sorted.begin[num_blocks] = end;
  sorted.row.resize(end);
  return sorted;
}

/// A panel per block column, as tall as its blocks.
BlockStructure StackPanels(std::vector<int> offset, Columns columns) {
  BlockStructure structure;
  structure.offset = std::move(offset);
  structure.column_begin = std::move(columns.begin);
  structure.row_block = std::move(columns.row);
  structure.row_in_panel.reserve(structure.row_block.size());
  const size_t num_blocks = structure.offset.size() - 1;
  structure.panel_begin.reserve(num_blocks);
  structure.panel_stride.reserve(num_blocks);
  for (size_t j = 0; j < num_blocks; ++j) {
    int height = 0;
    for (int64_t e = structure.column_begin[j]; e < structure.column_begin[j + 1]; ++e) {
      structure.row_in_panel.push_back(height);
      height += structure.block_size(structure.row_block[e]);
    }
    structure.panel_begin.push_back(structure.num_values);
    structure.panel_stride.push_back(height);
    structure.num_values += int64_t{height} * structure.block_size(static_cast<int>(j));
  }
  return structure;
}

}  // namespace

std::vector<int64_t> DiagonalBlockOffsets(const BlockStructure& structure) {
  std::vector<int64_t> begin = {0};
  for (int j = 0; j < structure.num_blocks(); ++j) {
    const int64_t size = structure.block_size(j);
    begin.push_back(begin.back() + size * size);
  }
  return begin;
}

BlockStructure DenseStructure(const std::vector<int>& block_sizes) {
  BlockStructure structure;
  structure.dense = true;
  structure.offset = Offsets(block_sizes);
  const auto num_blocks = static_cast<int64_t>(block_sizes.size());
  const int64_t n = structure.num_columns();
  structure.num_values = n * n;
  structure.panel_stride.assign(num_blocks, static_cast<int>(n));
  structure.row_block.reserve(num_blocks * (num_blocks + 1) / 2);
  structure.row_in_panel.reserve(num_blocks * (num_blocks + 1) / 2);
  structure.column_begin.push_back(0);
  for (int j = 0; j < num_blocks; ++j) {
    const int64_t first = structure.offset[j];
    structure.panel_begin.push_back(first * n + first);
    for (int i = j; i < num_blocks; ++i) {
      structure.row_block.push_back(i);
      structure.row_in_panel.push_back(structure.offset[i] - structure.offset[j]);
    }
    structure.column_begin.push_back(static_cast<int64_t>(structure.row_block.size()));
  }
  return structure;
}

BlockStructure SparseStructure(const std::vector<int>& block_sizes,
                               const std::vector<std::vector<int>>& columns) {
  Columns joined;
  joined.begin.push_back(0);
  for (const std::vector<int>& rows : columns) {
    joined.row.insert(joined.row.end(), rows.begin(), rows.end());
    joined.begin.push_back(static_cast<int64_t>(joined.row.size()));
  }
  return StackPanels(Offsets(block_sizes), std::move(joined));
}

BlockStructure StructureOfPairs(int num_nodes, int block_size,
                                const std::vector<std::pair<int, int>>& pairs) {
  Columns columns = SortBlocks(num_nodes, [&](const auto& visit) {
    for (const auto& [a, b] : pairs) visit(std::max(a, b), std::min(a, b));
  });
  return StackPanels(Offsets(std::vector<int>(num_nodes, block_size)), std::move(columns));
}

BlockStructure Reorder(const BlockStructure& structure, const std::vector<int>& order) {
  const int num_blocks = structure.num_blocks();
  std::vector<int> position(num_blocks), sizes(num_blocks);
  for (int k = 0; k < num_blocks; ++k) {
    position[order[k]] = k;
    sizes[k] = structure.block_size(order[k]);
  }
  Columns columns = SortBlocks(num_blocks, [&](const auto& visit) {
    for (int j = 0; j < num_blocks; ++j) {
      for (int64_t e = structure.column_begin[j] + 1; e < structure.column_begin[j + 1]; ++e) {
        const int a = position[j], b = position[structure.row_block[e]];
        visit(std::max(a, b), std::min(a, b));
      }
    }
  });
  return StackPanels(Offsets(sizes), std::move(columns));
}

BlockStructure CompactStructure(const BlockStructure& structure) {
  std::vector<int> identity(structure.num_blocks());
  std::iota(identity.begin(), identity.end(), 0);
  return Reorder(structure, identity);
}

void AddBlocks(const BlockStructure& from, const double* values, const BlockStructure& to,
               double* sums) {
  if (from.offset != to.offset)
    throw std::logic_error("AddBlocks: expected blocks of the same sizes");
  for (int j = 0; j < from.num_blocks(); ++j) {
    for (int64_t e = from.column_begin[j]; e < from.column_begin[j + 1]; ++e) {
      const int i = from.row_block[e];
      const int64_t target = to.Entry(j, i);
      if (target == to.column_begin[j + 1] || to.row_block[target] != i)
        throw std::logic_error("AddBlocks: expected every block in both");
      for (int c = 0; c < from.block_size(j); ++c) {
        const double* const source = values + from.ValueIndex(j, e, 0, c);
        double* const sum = sums + to.ValueIndex(j, target, 0, c);
        for (int r = 0; r < from.block_size(i); ++r) sum[r] += source[r];
      }
    }
  }
}

void CopyBlock(const BlockStructure& structure, const BlockValues& values, int row, int column,
               double* out) {
  const int rows = structure.block_size(row), columns = structure.block_size(column);
  const bool is_stored = row >= column;
  const int j = is_stored ? column : row;
  const int64_t entry = structure.Entry(j, is_stored ? row : column);
  const double* const from = values.data() + structure.ValueIndex(j, entry, 0, 0);
  const int64_t stride = structure.panel_stride[j];
  for (int r = 0; r < rows; ++r) {
    for (int c = 0; c < columns; ++c) {
      // Only the lower triangle of diagonal blocks is defined.
      const bool is_lower = row == column ? r >= c : is_stored;
      *out++ = is_lower ? from[c * stride + r] : from[r * stride + c];
    }
  }
}

}  // namespace bundle

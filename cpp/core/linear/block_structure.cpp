#include "core/linear/block_structure.h"

#if defined(__linux__)
#include <sys/mman.h>
#endif

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <stdexcept>

namespace bundle {

namespace {

std::vector<int> Offsets(const std::vector<int>& block_sizes) {
  std::vector<int> offset(block_sizes.size() + 1, 0);
  std::partial_sum(block_sizes.begin(), block_sizes.end(), offset.begin() + 1);
  return offset;
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
  BlockStructure structure;
  structure.offset = Offsets(block_sizes);
  size_t num_entries = 0;
  for (const std::vector<int>& rows : columns) num_entries += rows.size();
  structure.row_block.reserve(num_entries);
  structure.row_in_panel.reserve(num_entries);
  structure.column_begin.push_back(0);
  for (size_t j = 0; j < columns.size(); ++j) {
    int height = 0;
    for (const int i : columns[j]) {
      structure.row_block.push_back(i);
      structure.row_in_panel.push_back(height);
      height += block_sizes[i];
    }
    structure.column_begin.push_back(static_cast<int64_t>(structure.row_block.size()));
    structure.panel_begin.push_back(structure.num_values);
    structure.panel_stride.push_back(height);
    structure.num_values += static_cast<int64_t>(height) * block_sizes[j];
  }
  return structure;
}

BlockStructure StructureOfPairs(int num_nodes, int block_size,
                                const std::vector<std::pair<int, int>>& pairs) {
  std::vector<std::vector<int>> columns(num_nodes);
  for (int i = 0; i < num_nodes; ++i) columns[i].push_back(i);
  for (const auto& [a, b] : pairs) columns[std::min(a, b)].push_back(std::max(a, b));
  for (std::vector<int>& rows : columns) {
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
  }
  return SparseStructure(std::vector<int>(num_nodes, block_size), columns);
}

BlockStructure Reorder(const BlockStructure& structure, const std::vector<int>& order) {
  const int num_blocks = structure.num_blocks();
  std::vector<int> position(num_blocks), sizes(num_blocks);
  for (int k = 0; k < num_blocks; ++k) {
    position[order[k]] = k;
    sizes[k] = structure.block_size(order[k]);
  }
  std::vector<std::vector<int>> columns(num_blocks);
  for (int j = 0; j < num_blocks; ++j) {
    for (int64_t e = structure.column_begin[j]; e < structure.column_begin[j + 1]; ++e) {
      const int a = position[j], b = position[structure.row_block[e]];
      columns[std::min(a, b)].push_back(std::max(a, b));
    }
  }
  for (std::vector<int>& rows : columns) std::sort(rows.begin(), rows.end());
  return SparseStructure(sizes, columns);
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

#if defined(__linux__)
void AdviseHugePages(void* begin, size_t num_bytes) {
  constexpr uintptr_t kHugePage = uintptr_t{1} << 21;
  const auto address = reinterpret_cast<uintptr_t>(begin);
  const uintptr_t first = (address + kHugePage - 1) / kHugePage * kHugePage;
  const uintptr_t last = (address + num_bytes) / kHugePage * kHugePage;
  // If the system refuses, only the time changes.
  if (last > first) madvise(reinterpret_cast<void*>(first), last - first, MADV_HUGEPAGE);
}
#else
void AdviseHugePages(void*, size_t) {}
#endif

void CopyBlock(const BlockStructure& structure, const std::vector<double>& values, int row,
               int column, double* out) {
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

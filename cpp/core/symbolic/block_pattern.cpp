#include "core/symbolic/block_pattern.h"

/// Validation, permutation and counts of patterns of symmetric block matrices.

#include <algorithm>
#include <numeric>
#include <string>
#include <utility>

#include "core/error.h"

namespace bundle {
namespace {

std::string Column(int j) { return "block column " + std::to_string(j) + ": "; }

void CheckColumn(const BlockPatternView& pattern, int j) {
  const int64_t begin = pattern.column_begin[j], end = pattern.column_begin[j + 1];
  if (begin == end || pattern.row[begin] != j) {
    throw InputError(
        Column(j) + "expected the diagonal block as its first entry, found " +
        (begin == end ? "an empty column" : "row " + std::to_string(pattern.row[begin])));
  }
  for (int64_t e = begin + 1; e < end; ++e) {
    const int row = pattern.row[e];
    if (row <= pattern.row[e - 1]) {
      throw InputError(Column(j) + "expected ascending rows, found " + std::to_string(row) +
                       " after " + std::to_string(pattern.row[e - 1]));
    }
    if (row >= pattern.num_blocks) {
      throw InputError(Column(j) + "expected rows below " + std::to_string(pattern.num_blocks) +
                       ", found " + std::to_string(row));
    }
  }
}

}  // namespace

BlockPattern MakeBlockPattern(std::vector<int> size, const std::vector<std::vector<int>>& columns) {
  BlockPattern pattern;
  pattern.size = std::move(size);
  pattern.column_begin.reserve(columns.size() + 1);
  int64_t num_entries = 0;
  for (const std::vector<int>& column : columns) {
    num_entries += static_cast<int64_t>(column.size());
    pattern.column_begin.push_back(num_entries);
  }
  pattern.row.reserve(num_entries);
  for (const std::vector<int>& column : columns) {
    pattern.row.insert(pattern.row.end(), column.begin(), column.end());
  }
  return pattern;
}

void CheckBlockPattern(const BlockPatternView& pattern) {
  for (int j = 0; j < pattern.num_blocks; ++j) {
    if (pattern.size[j] < 1) {
      throw InputError("block " + std::to_string(j) + ": expected a size of at least 1, found " +
                       std::to_string(pattern.size[j]));
    }
  }
  if (pattern.column_begin[0] != 0) {
    throw InputError("block columns: expected the first to begin at 0, found " +
                     std::to_string(pattern.column_begin[0]));
  }
  // Checked before any row is read: every range is within the rows.
  for (int j = 0; j < pattern.num_blocks; ++j) {
    if (pattern.column_begin[j + 1] < pattern.column_begin[j]) {
      throw InputError(Column(j) + "expected to end at " + std::to_string(pattern.column_begin[j]) +
                       " or later, found " + std::to_string(pattern.column_begin[j + 1]));
    }
  }
  for (int j = 0; j < pattern.num_blocks; ++j) CheckColumn(pattern, j);
}

BlockRows PermuteRows(const BlockPatternView& pattern, const std::vector<int>& blocks) {
  const int n = pattern.num_blocks;
  std::vector<int> position(n);
  for (int k = 0; k < n; ++k) position[blocks[k]] = k;
  const auto for_each = [&](const auto& visit) {
    for (int j = 0; j < n; ++j) {
      for (int64_t e = pattern.column_begin[j]; e < pattern.column_begin[j + 1]; ++e) {
        const auto [column, row] = std::minmax(position[pattern.row[e]], position[j]);
        visit(row, column);
      }
    }
  };
  BlockRows rows;
  rows.begin.assign(n + 1, 0);
  for_each([&](int row, int) { ++rows.begin[row + 1]; });
  std::partial_sum(rows.begin.begin(), rows.begin.end(), rows.begin.begin());
  rows.column.resize(rows.begin.back());
  std::vector<int64_t> next(rows.begin.begin(), rows.begin.end() - 1);
  for_each([&](int row, int column) { rows.column[next[row]++] = column; });
  return rows;
}

BlockPattern PatternOfRows(const BlockRows& rows, std::vector<int> size) {
  BlockPattern pattern;
  const int n = static_cast<int>(size.size());
  pattern.size = std::move(size);
  pattern.column_begin.assign(n + 1, 0);
  for (const int column : rows.column) ++pattern.column_begin[column + 1];
  std::partial_sum(pattern.column_begin.begin(), pattern.column_begin.end(),
                   pattern.column_begin.begin());
  pattern.row.resize(rows.column.size());
  std::vector<int64_t> next(pattern.column_begin.begin(), pattern.column_begin.end() - 1);
  for (int row = 0; row < n; ++row) {  // ascending, so that each column is sorted, too
    for (int64_t e = rows.begin[row]; e < rows.begin[row + 1]; ++e) {
      pattern.row[next[rows.column[e]]++] = row;
    }
  }
  return pattern;
}

int64_t NumColumns(const BlockPatternView& pattern) {
  int64_t num_columns = 0;
  for (int j = 0; j < pattern.num_blocks; ++j) num_columns += pattern.size[j];
  return num_columns;
}

double NumNonzeros(const BlockPatternView& pattern) {
  double count = 0;
  for (int j = 0; j < pattern.num_blocks; ++j) {
    for (int64_t e = pattern.column_begin[j]; e < pattern.column_begin[j + 1]; ++e) {
      const int i = pattern.row[e];
      count += (i == j ? 1. : 2.) * pattern.size[i] * pattern.size[j];
    }
  }
  return count;
}

}  // namespace bundle

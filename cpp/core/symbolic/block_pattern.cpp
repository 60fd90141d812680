#include "core/symbolic/block_pattern.h"

#include <string>
#include <utility>

#include "core/error.h"

namespace bundle {
namespace {

std::string Column(int j) { return "block column " + std::to_string(j) + ": "; }

void CheckColumn(const BlockPatternView& pattern, int j) {
  const int64_t begin = pattern.column_begin[j], end = pattern.column_begin[j + 1];
  if (begin == end || pattern.row[begin] != j) {
    throw InputError(Column(j) + "expected the diagonal block as its first entry, found " +
                     (begin == end ? "none" : "row " + std::to_string(pattern.row[begin])));
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
  if (pattern.num_blocks > 0 && pattern.column_begin[0] != 0) {
    throw InputError("block columns: expected the first to begin at 0, found " +
                     std::to_string(pattern.column_begin[0]));
  }
  // Before any row is read: every range lies within the rows.
  for (int j = 0; j < pattern.num_blocks; ++j) {
    if (pattern.column_begin[j + 1] < pattern.column_begin[j]) {
      throw InputError(Column(j) + "expected to end at " + std::to_string(pattern.column_begin[j]) +
                       " or later, found " + std::to_string(pattern.column_begin[j + 1]));
    }
  }
  for (int j = 0; j < pattern.num_blocks; ++j) CheckColumn(pattern, j);
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

#include "core/fused/reduced/reordered_matrix.h"

#include <algorithm>
#include <utility>

#include "core/parallel_for.h"

namespace bundle::fused {
namespace {

constexpr int64_t kValuesWorthAThread = 100000;

}  // namespace

ReorderedMatrix::ReorderedMatrix(const ReducedStructure& from, const std::vector<int>& order)
    : from_(from), order_(order) {
  if (std::is_sorted(order.begin(), order.end())) {
    structure_ = from;
    return;
  }
  const int num_blocks = from.num_blocks();
  std::vector<int> position(num_blocks);
  std::vector<int> sizes(num_blocks);
  for (int k = 0; k < num_blocks; ++k) {
    position[order[k]] = k;
    sizes[k] = from.block_size(order[k]);
  }

  // Entries by their new row, so that going through the rows fills each new column in order.
  struct Entry {
    int64_t index;
    int column;  // new
    bool transposed;
  };
  std::vector<std::vector<Entry>> rows(num_blocks);
  for (int j = 0; j < num_blocks; ++j) {
    for (int64_t e = from.column_begin[j]; e < from.column_begin[j + 1]; ++e) {
      const int a = position[from.row_block[e]];
      const int b = position[j];
      rows[std::max(a, b)].push_back({e, std::min(a, b), a < b});
    }
  }
  std::vector<std::vector<int>> columns(num_blocks);
  for (int row = 0; row < num_blocks; ++row) {
    for (const Entry& entry : rows[row]) columns[entry.column].push_back(row);
  }
  structure_ = SparseStructure(sizes, columns);

  targets_.resize(from.row_block.size());
  std::vector<int64_t> next(structure_.column_begin.begin(), structure_.column_begin.end() - 1);
  for (int row = 0; row < num_blocks; ++row) {
    for (const Entry& entry : rows[row]) {
      const int column = entry.column;
      targets_[entry.index] = {structure_.ValueIndex(column, next[column]++, 0, 0),
                               structure_.panel_stride[column], entry.transposed};
    }
  }
  values_.resize(structure_.num_values);
}

double* ReorderedMatrix::Reorder(std::vector<double>* values, int num_threads) {
  if (targets_.empty()) return values->data();
  if (from_.num_values < kValuesWorthAThread) num_threads = 1;
  ParallelFor(
      from_.num_blocks(), num_threads,
      [&](int64_t begin, int64_t end) {
        for (int64_t j = begin; j < end; ++j) ReorderColumn(static_cast<int>(j), values->data());
      },
      1);
  return values_.data();
}

void ReorderedMatrix::ReorderColumn(int j, const double* values) {
  const int num_columns = from_.block_size(j);
  for (int64_t e = from_.column_begin[j]; e < from_.column_begin[j + 1]; ++e) {
    const int num_rows = from_.block_size(from_.row_block[e]);
    const Target& target = targets_[e];
    double* to = values_.data() + target.begin;
    for (int c = 0; c < num_columns; ++c) {
      const double* column = values + from_.ValueIndex(j, e, 0, c);
      if (target.transposed) {
        for (int r = 0; r < num_rows; ++r)
          to[static_cast<int64_t>(r) * target.stride + c] = column[r];
      } else {
        std::copy(column, column + num_rows, to + static_cast<int64_t>(c) * target.stride);
      }
    }
  }
}

void ReorderedMatrix::ReorderVector(const double* from, double* to) const {
  for (const int block : order_) {
    to = std::copy(from + from_.offset[block], from + from_.offset[block + 1], to);
  }
}

void ReorderedMatrix::RestoreVector(const double* from, double* to) const {
  for (const int block : order_) {
    std::copy(from, from + from_.block_size(block), to + from_.offset[block]);
    from += from_.block_size(block);
  }
}

}  // namespace bundle::fused

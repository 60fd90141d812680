#include "core/linear/supernodal_cholesky.h"

/// Left-looking: a panel first receives the updates of earlier panels to its columns. Then its
/// diagonal block is factorised, D = L_D L_D^T, and its rows below become B L_D^-T. To update panel
/// s, an earlier panel multiplies its rows from the columns of s on by its rows in the columns of
/// s. This matrix product is then scattered to its places in s. Each panel waits in one queue: that
/// of the next panel in which it has rows (Ng and Peyton, Block sparse Cholesky algorithms on
/// advanced uniprocessor computers, 1993; CHOLMOD does the same).
///
/// This code differs from CHOLMOD, and does not use it, because S is assembled directly in the
/// memory of L. CHOLMOD reads S from another array, with a row index for each value, and copies it.
/// Here, rows are given as blocks and as ranges of rows, which are added contiguously. If all rows
/// of a product are one range, it is subtracted at its place.
///
/// Threads first factorise subtrees (panel_subtrees.cpp). A panel whose next update is above its
/// subtree leaves its queue. These panels are then queued in the order of the subtrees, and the
/// panels of the top follow in order, each by all threads: its updates in slices of its columns,
/// its rows below in slices of rows. An entry of a panel takes the same sums in the same order in
/// any slice (kernels/panel_kernels.h). So the bits do not depend on the number of threads.

#include <algorithm>
#include <utility>

namespace bundle {
namespace {

constexpr int kRowsOfSlice = 192;
/// Products of numbers between two looks for an interruption, less than a millisecond.
constexpr int64_t kWorkBetweenLooks = 1 << 22;

int64_t Slices(int size, int of_slice) { return (size + of_slice - 1) / of_slice; }

}  // namespace

SupernodalCholesky::SupernodalCholesky(std::vector<int> offset, Supernodes supernodes)
    : offset_(std::move(offset)),
      supernodes_(std::move(supernodes)),
      panel_of_(PanelOfBlocks(supernodes_)),
      subtrees_(FindSubtrees(supernodes_, offset_)),
      next_update_(supernodes_.num_panels()),
      next_row_(supernodes_.num_panels()),
      leaving_(subtrees_.subtrees.size()),
      scratch_(1) {}

int SupernodalCholesky::BlockSize(int64_t row) const {
  const int block = supernodes_.row_block[row];
  return offset_[block + 1] - offset_[block];
}

int SupernodalCholesky::Factorize(double* values, ThreadPool* pool) {
  const size_t num_threads = pool == nullptr ? 1 : pool->num_threads();
  if (scratch_.size() < num_threads) scratch_.resize(num_threads);
  first_update_.assign(supernodes_.num_panels(), -1);
  std::vector<int> failed(subtrees_.subtrees.size(), 0);
  ForEach(pool, static_cast<int64_t>(failed.size()), [&](int64_t k, int thread) {
    const int subtree = subtrees_.order[k];
    failed[subtree] = FactorizeSubtree(subtree, values, &scratch_[thread]);
  });
  // The first subtree that fails has the smallest of these minors: subtrees are in the order of S.
  for (const int minor : failed) {
    if (minor != 0) return minor;
  }
  for (const std::vector<int>& panels : leaving_) {
    for (const int panel : panels) QueueUpdate(panel, next_row_[panel]);
  }
  for (const int panel : subtrees_.top) {
    const int minor = FactorizePanel(panel, values, pool, scratch_.data());
    if (minor != 0) return minor;
    PassOn(panel, [&](int by) { QueueUpdate(by, next_row_[by]); });
  }
  return 0;
}

int SupernodalCholesky::FactorizeSubtree(int subtree, double* values, Scratch* scratch) {
  const PanelRange range = subtrees_.subtrees[subtree];
  leaving_[subtree].clear();
  for (int s = range.first; s < range.last; ++s) {
    const int minor = FactorizePanel(s, values, nullptr, scratch);
    if (minor != 0) return minor;
    PassOn(s, [&](int by) {
      const bool leaves = next_row_[by] < supernodes_.rows_begin[by + 1] &&
                          panel_of_[supernodes_.row_block[next_row_[by]]] >= range.last;
      if (leaves) {
        leaving_[subtree].push_back(by);
      } else {
        QueueUpdate(by, next_row_[by]);
      }
    });
  }
  return 0;
}

/// Calls queue(by) for the panels that have updated this one, and for the panel itself, with
/// next_row_ after the columns of the panel.
template <typename Queue>
void SupernodalCholesky::PassOn(int panel, const Queue& queue) {
  for (int by = first_update_[panel]; by >= 0;) {
    const int next = next_update_[by];
    next_row_[by] = RowFrom(by, next_row_[by], supernodes_.first_block[panel + 1]);
    queue(by);
    by = next;
  }
  next_row_[panel] = supernodes_.rows_begin[panel];
  queue(panel);
}

/// Adds the panel to the queue of the panel that has `first_row` among its columns.
void SupernodalCholesky::QueueUpdate(int panel, int64_t first_row) {
  if (first_row == supernodes_.rows_begin[panel + 1]) return;
  int& first = first_update_[panel_of_[supernodes_.row_block[first_row]]];
  next_update_[panel] = first;
  first = panel;
}

/// The first row of the panel, from `row` on, that is not before `block`.
int64_t SupernodalCholesky::RowFrom(int panel, int64_t row, int block) const {
  const int64_t end = supernodes_.rows_begin[panel + 1];
  while (row < end && supernodes_.row_block[row] < block) ++row;
  return row;
}

/// Updates and factorises a panel whose updates are all in its queue. nullptr: on this thread.
int SupernodalCholesky::FactorizePanel(int panel, double* values, ThreadPool* pool,
                                       Scratch* scratch) {
  const int first_column = FirstColumn(panel), width = Width(panel);
  const int height = supernodes_.height[panel];
  if (first_update_[panel] >= 0) {
    LocateRows(panel, &scratch->position);
    const auto first_block = offset_.begin() + supernodes_.first_block[panel];
    const auto end_block = offset_.begin() + supernodes_.first_block[panel + 1];
    const auto block_at = [&](int column) {
      return static_cast<int>(std::lower_bound(first_block, end_block, first_column + column) -
                              offset_.begin());
    };
    ForEach(pool, Slices(width, kColumnsOfSlice), [&](int64_t k, int thread) {
      const int column = static_cast<int>(k) * kColumnsOfSlice;
      UpdateColumns(panel, block_at(column), block_at(column + kColumnsOfSlice), values,
                    scratch->position, pool == nullptr ? scratch : &scratch_[thread]);
    });
  }
  double* const own = values + supernodes_.values_begin[panel];
  const int rows = std::min(height, width + kRowsOfSlice);
  const int failed = kernels_.factorize(own, height, rows, width);
  if (failed != 0) return first_column + failed;
  ForEach(pool, Slices(height - rows, kRowsOfSlice), [&](int64_t k, int /*thread*/) {
    const int row = rows + static_cast<int>(k) * kRowsOfSlice;
    kernels_.solve_rows(own, height, width, own + row, std::min(kRowsOfSlice, height - row));
  });
  return 0;
}

/// Positions of all rows of the panel.
void SupernodalCholesky::LocateRows(int panel, std::vector<int>* position) const {
  position->resize(panel_of_.size());
  for (int j = supernodes_.first_block[panel]; j < supernodes_.first_block[panel + 1]; ++j) {
    (*position)[j] = offset_[j] - FirstColumn(panel);
  }
  for (int64_t e = supernodes_.rows_begin[panel]; e < supernodes_.rows_begin[panel + 1]; ++e) {
    (*position)[supernodes_.row_block[e]] = supernodes_.row_in_panel[e];
  }
}

/// Applies the updates in the queue of a panel to its block columns [first_block, last_block).
void SupernodalCholesky::UpdateColumns(int panel, int first_block, int last_block, double* values,
                                       const std::vector<int>& position, Scratch* scratch) const {
  for (int by = first_update_[panel]; by >= 0; by = next_update_[by]) {
    const int64_t first_row = RowFrom(by, next_row_[by], first_block);
    const int64_t last_row = RowFrom(by, first_row, last_block);
    if (first_row < last_row) {
      Update(panel, by, first_row, last_row, values, position, scratch);
    }
  }
}

/// Updates the columns of `panel` that are rows [first_row, last_row) of `by`.
void SupernodalCholesky::Update(int panel, int by, int64_t first_row, int64_t last_row,
                                double* values, const std::vector<int>& position,
                                Scratch* scratch) const {
  const int top = supernodes_.row_in_panel[first_row];
  const int width = Width(by), stride = supernodes_.height[by], rows = stride - top;
  const int columns = supernodes_.row_in_panel[last_row - 1] + BlockSize(last_row - 1) - top;
  scratch->work += static_cast<int64_t>(rows) * columns * width;
  if (scratch->work > kWorkBetweenLooks) {
    scratch->work = 0;
    ThrowIfInterrupted();
  }
  FindRowRanges(by, first_row, position, &scratch->ranges);
  const double* const from = values + supernodes_.values_begin[by] + top;
  const int target_stride = supernodes_.height[panel];
  double* const to = values + supernodes_.values_begin[panel];
  if (scratch->ranges.size() == 1) {
    const int64_t target = scratch->ranges.front().target;
    return kernels_.subtract_product(from, stride, rows, columns, width,
                                     to + target + target * target_stride, target_stride);
  }
  std::vector<double>& product = scratch->product;
  product.resize(std::max(product.size(), static_cast<size_t>(rows) * columns));
  kernels_.product(from, stride, rows, columns, width, product.data(), rows);
  kernels_.scatter(product.data(), rows, columns, scratch->ranges.data(),
                   static_cast<int>(scratch->ranges.size()), to, target_stride);
}

/// Finds the ranges of the rows of panel `by` from `first_row` on.
void SupernodalCholesky::FindRowRanges(int by, int64_t first_row, const std::vector<int>& position,
                                       std::vector<RowRange>* ranges) const {
  ranges->clear();
  const int top = supernodes_.row_in_panel[first_row];
  for (int64_t e = first_row; e < supernodes_.rows_begin[by + 1]; ++e) {
    const int source = supernodes_.row_in_panel[e] - top;
    const int target = position[supernodes_.row_block[e]];
    if (ranges->empty() || ranges->back().target + ranges->back().length != target) {
      ranges->push_back({source, target, 0});
    }
    ranges->back().length += BlockSize(e);
  }
}

}  // namespace bundle

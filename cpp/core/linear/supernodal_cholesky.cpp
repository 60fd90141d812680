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
/// of a product are one range, BLAS itself adds it at its place.
///
/// A product takes some columns at a time, so that it is still in the cache when it is added.

#include <algorithm>
#include <utility>

#include "core/parallel/blas.h"
#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

constexpr int kProductColumns = 96;

}  // namespace

SupernodalCholesky::SupernodalCholesky(std::vector<int> offset, Supernodes supernodes)
    : offset_(std::move(offset)),
      supernodes_(std::move(supernodes)),
      panel_of_(offset_.size() - 1),
      position_(offset_.size() - 1),
      next_update_(supernodes_.num_panels()),
      next_row_(supernodes_.num_panels()) {
  for (int s = 0; s < supernodes_.num_panels(); ++s) {
    std::fill(panel_of_.begin() + supernodes_.first_block[s],
              panel_of_.begin() + supernodes_.first_block[s + 1], s);
  }
}

int SupernodalCholesky::BlockSize(int64_t row) const {
  const int block = supernodes_.row_block[row];
  return offset_[block + 1] - offset_[block];
}

int SupernodalCholesky::Factorize(double* values) {
  constexpr char kRight = 'R', kLower = 'L', kTransposed = 'T', kNonUnit = 'N';
  constexpr double kOne = 1;
  first_update_.assign(supernodes_.num_panels(), -1);
  for (int s = 0; s < supernodes_.num_panels(); ++s) {
    LocateRows(s);
    for (int by = first_update_[s]; by >= 0;) {
      const int next = next_update_[by];
      Update(s, by, values);
      by = next;
    }
    double* const panel = values + supernodes_.values_begin[s];
    const int width = Width(s), height = supernodes_.height[s], below = height - width;
    int info = 0;
    dpotrf_(&kLower, &width, panel, &height, &info);
    if (info != 0) return FirstColumn(s) + info;
    if (below == 0) continue;
    dtrsm_(&kRight, &kLower, &kTransposed, &kNonUnit, &below, &width, &kOne, panel, &height,
           panel + width, &height);
    QueueUpdate(s, supernodes_.rows_begin[s]);
  }
  return 0;
}

/// position_ of all rows of the panel.
void SupernodalCholesky::LocateRows(int panel) {
  for (int j = supernodes_.first_block[panel]; j < supernodes_.first_block[panel + 1]; ++j) {
    position_[j] = offset_[j] - FirstColumn(panel);
  }
  for (int64_t e = supernodes_.rows_begin[panel]; e < supernodes_.rows_begin[panel + 1]; ++e) {
    position_[supernodes_.row_block[e]] = supernodes_.row_in_panel[e];
  }
}

/// Adds the panel to the queue of the panel that has `first_row` among its columns.
void SupernodalCholesky::QueueUpdate(int panel, int64_t first_row) {
  next_row_[panel] = first_row;
  if (first_row == supernodes_.rows_begin[panel + 1]) return;
  int& first = first_update_[panel_of_[supernodes_.row_block[first_row]]];
  next_update_[panel] = first;
  first = panel;
}

void SupernodalCholesky::Update(int panel, int by, double* values) {
  const int end_block = supernodes_.first_block[panel + 1];
  const int64_t last_row = supernodes_.rows_begin[by + 1];
  int64_t row = next_row_[by];
  while (row < last_row && supernodes_.row_block[row] < end_block) {
    const int64_t first_row = row;
    int columns = 0;
    for (; row < last_row && supernodes_.row_block[row] < end_block; ++row) {
      columns += BlockSize(row);
      if (columns >= kProductColumns) {
        ++row;
        break;
      }
    }
    UpdateColumns(panel, by, first_row, row, values);
  }
  QueueUpdate(by, row);
}

/// Updates the columns of `panel` that are rows [first_row, last_row) of `by`.
void SupernodalCholesky::UpdateColumns(int panel, int by, int64_t first_row, int64_t last_row,
                                       double* values) {
  constexpr char kPlain = 'N', kTransposed = 'T';
  constexpr double kMinusOne = -1, kZero = 0, kOne = 1;
  ThrowIfInterrupted();
  FindRowRanges(by, first_row);
  const int top = supernodes_.row_in_panel[first_row];
  const int width = Width(by), stride = supernodes_.height[by], rows = stride - top;
  const int columns = supernodes_.row_in_panel[last_row - 1] + BlockSize(last_row - 1) - top;
  const double* const from = values + supernodes_.values_begin[by] + top;
  const int target_stride = supernodes_.height[panel];
  double* const to = values + supernodes_.values_begin[panel];
  if (row_ranges_.size() == 1) {
    const int position = row_ranges_.front().target;
    dgemm_(&kPlain, &kTransposed, &rows, &columns, &width, &kMinusOne, from, &stride, from, &stride,
           &kOne, to + position + static_cast<int64_t>(position) * target_stride, &target_stride);
    return;
  }
  product_.resize(std::max(product_.size(), static_cast<size_t>(rows) * columns));
  dgemm_(&kPlain, &kTransposed, &rows, &columns, &width, &kMinusOne, from, &stride, from, &stride,
         &kZero, product_.data(), &rows);
  const double* product = product_.data();
  for (int64_t e = first_row; e < last_row; ++e) {
    double* column = to + static_cast<int64_t>(position_[supernodes_.row_block[e]]) * target_stride;
    for (int c = 0; c < BlockSize(e); ++c, column += target_stride, product += rows) {
      for (const RowRange& range : row_ranges_) {
        double* const target = column + range.target;
        const double* const source = product + range.source;
        for (int i = 0; i < range.length; ++i) target[i] += source[i];
      }
    }
  }
}

/// Finds the ranges of the rows of panel `by` from `first_row` on.
void SupernodalCholesky::FindRowRanges(int by, int64_t first_row) {
  row_ranges_.clear();
  const int top = supernodes_.row_in_panel[first_row];
  for (int64_t e = first_row; e < supernodes_.rows_begin[by + 1]; ++e) {
    const int source = supernodes_.row_in_panel[e] - top;
    const int target = position_[supernodes_.row_block[e]];
    if (row_ranges_.empty() || row_ranges_.back().target + row_ranges_.back().length != target) {
      row_ranges_.push_back({source, target, 0});
    }
    row_ranges_.back().length += BlockSize(e);
  }
}

void SupernodalCholesky::Solve(const double* values, double* x, int num_rhs) {
  if (num_rhs == 1) return SolveOne(values, x);
  SolveMany(values, x, num_rhs);
}

void SupernodalCholesky::SolveOne(const double* values, double* x) {
  constexpr char kLower = 'L', kPlain = 'N', kTransposed = 'T', kNonUnit = 'N';
  constexpr double kMinusOne = -1, kZero = 0, kOne = 1;
  constexpr int kNext = 1;
  product_.resize(std::max(product_.size(), static_cast<size_t>(offset_.back())));
  double* const below = product_.data();
  const auto for_rows = [&](int s, const auto& visit) {
    for (int64_t e = supernodes_.rows_begin[s]; e < supernodes_.rows_begin[s + 1]; ++e) {
      double* const at = below + supernodes_.row_in_panel[e] - Width(s);
      visit(at, x + offset_[supernodes_.row_block[e]], BlockSize(e));
    }
  };
  for (int s = 0; s < supernodes_.num_panels(); ++s) {
    const double* const panel = values + supernodes_.values_begin[s];
    const int width = Width(s), height = supernodes_.height[s], rows = height - width;
    double* const own = x + FirstColumn(s);
    dtrsv_(&kLower, &kPlain, &kNonUnit, &width, panel, &height, own, &kNext);
    if (rows == 0) continue;
    dgemv_(&kPlain, &rows, &width, &kOne, panel + width, &height, own, &kNext, &kZero, below,
           &kNext);
    for_rows(s, [](const double* from, double* to, int size) {
      for (int i = 0; i < size; ++i) to[i] -= from[i];
    });
  }
  for (int s = supernodes_.num_panels() - 1; s >= 0; --s) {
    const double* const panel = values + supernodes_.values_begin[s];
    const int width = Width(s), height = supernodes_.height[s], rows = height - width;
    double* const own = x + FirstColumn(s);
    if (rows > 0) {
      for_rows(s, [](double* to, const double* from, int size) { std::copy_n(from, size, to); });
      dgemv_(&kTransposed, &rows, &width, &kMinusOne, panel + width, &height, below, &kNext, &kOne,
             own, &kNext);
    }
    dtrsv_(&kLower, &kTransposed, &kNonUnit, &width, panel, &height, own, &kNext);
  }
}

void SupernodalCholesky::SolveMany(const double* values, double* x, int num_rhs) {
  constexpr char kLeft = 'L', kLower = 'L', kPlain = 'N', kTransposed = 'T', kNonUnit = 'N';
  constexpr double kMinusOne = -1, kZero = 0, kOne = 1;
  const int n = offset_.back();
  product_.resize(std::max(product_.size(), static_cast<size_t>(n) * num_rhs));
  double* const below = product_.data();
  // Gathers the rows of X that panel s has below its own columns.
  const auto for_rows = [&](int s, int rows, const auto& visit) {
    for (int k = 0; k < num_rhs; ++k) {
      double* at = below + static_cast<int64_t>(k) * rows;
      double* const column = x + static_cast<int64_t>(k) * n;
      for (int64_t e = supernodes_.rows_begin[s]; e < supernodes_.rows_begin[s + 1]; ++e) {
        const int size = BlockSize(e);
        visit(at, column + offset_[supernodes_.row_block[e]], size);
        at += size;
      }
    }
  };
  for (int s = 0; s < supernodes_.num_panels(); ++s) {
    const double* const panel = values + supernodes_.values_begin[s];
    const int width = Width(s), height = supernodes_.height[s], rows = height - width;
    double* const own = x + FirstColumn(s);
    dtrsm_(&kLeft, &kLower, &kPlain, &kNonUnit, &width, &num_rhs, &kOne, panel, &height, own, &n);
    if (rows == 0) continue;
    dgemm_(&kPlain, &kPlain, &rows, &num_rhs, &width, &kOne, panel + width, &height, own, &n,
           &kZero, below, &rows);
    for_rows(s, rows, [](const double* from, double* to, int size) {
      for (int i = 0; i < size; ++i) to[i] -= from[i];
    });
  }
  for (int s = supernodes_.num_panels() - 1; s >= 0; --s) {
    const double* const panel = values + supernodes_.values_begin[s];
    const int width = Width(s), height = supernodes_.height[s], rows = height - width;
    double* const own = x + FirstColumn(s);
    if (rows > 0) {
      for_rows(s, rows,
               [](double* to, const double* from, int size) { std::copy_n(from, size, to); });
      dgemm_(&kTransposed, &kPlain, &width, &num_rhs, &rows, &kMinusOne, panel + width, &height,
             below, &rows, &kOne, own, &n);
    }
    dtrsm_(&kLeft, &kLower, &kTransposed, &kNonUnit, &width, &num_rhs, &kOne, panel, &height, own,
           &n);
  }
}

}  // namespace bundle

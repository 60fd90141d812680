#include "core/linear/symmetric_product.h"

/// y = S x with S = L + D + L^T stored as L + D, by block columns:
///
///   y_j += D_j x_j + P_j^T x_below,   y_below += P_j x_j,
///
/// with P_j the panel of block column j below its diagonal block. Both products read each value of
/// P_j once from memory, 4 flops for 8 bytes, so memory bandwidth limits the speed. The rows of the
/// panel are gathered and scattered a block at a time, 2 m accesses to cache for m^2 values from
/// memory. Some rows are processed at a time, so that x and y stay in L1 while three columns of
/// values stream by.
///
/// Block columns are divided into ranges of equally many values. A range adds into its own vector,
/// as long as the rows that it reaches. These vectors are then added in order. The ranges, and
/// therefore all bits of y, are the same for any number of threads.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "core/linear/block_structure.h"
#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

constexpr int kMaxRanges = 16;
constexpr int64_t kMinRangeValues = 20000;
constexpr int kRowsAtATime = 1024;
constexpr int kLanes = 4;
using Lanes = double __attribute__((vector_size(kLanes * sizeof(double))));

/// y += P x_j and sums += P^T x for kColumns columns of `rows` rows, `stride` apart.
template <int kColumns>
void MultiplyColumns(const double* values, int64_t stride, int rows, const double* x_j,
                     const double* __restrict x, double* __restrict y, double* sums) {
  Lanes lane_sums[kColumns] = {};
  int row = 0;
  for (; row + kLanes <= rows; row += kLanes) {
    Lanes x_lanes, y_lanes;
    std::memcpy(&x_lanes, x + row, sizeof(Lanes));
    std::memcpy(&y_lanes, y + row, sizeof(Lanes));
    for (int c = 0; c < kColumns; ++c) {
      Lanes p;
      std::memcpy(&p, values + c * stride + row, sizeof(Lanes));
      y_lanes += p * x_j[c];
      lane_sums[c] += p * x_lanes;
    }
    std::memcpy(y + row, &y_lanes, sizeof(Lanes));
  }
  for (int c = 0; c < kColumns; ++c) {
    for (int lane = 0; lane < kLanes; ++lane) sums[c] += lane_sums[c][lane];
  }
  for (; row < rows; ++row) {
    for (int c = 0; c < kColumns; ++c) {
      const double p = values[c * stride + row];
      y[row] += p * x_j[c];
      sums[c] += p * x[row];
    }
  }
}

/// y += D x for a diagonal block whose lower triangle is defined.
void MultiplyDiagonalBlock(const double* values, int64_t stride, int size, const double* x,
                           double* y) {
  for (int c = 0; c < size; ++c) {
    const double* column = values + c * stride;
    y[c] += column[c] * x[c];
    for (int r = c + 1; r < size; ++r) {
      y[r] += column[r] * x[c];
      y[c] += column[r] * x[r];
    }
  }
}

int64_t CountRanges(const BlockStructure& structure) {
  return std::clamp<int64_t>(structure.num_values / kMinRangeValues, 1, kMaxRanges);
}

/// At most as many threads as ranges.
int CountThreads(const BlockStructure& structure, int num_threads) {
  return static_cast<int>(
      std::min<int64_t>(EffectiveNumThreads(num_threads), CountRanges(structure)));
}

int PanelRows(const BlockStructure& structure, int j) {
  const int64_t last = structure.column_begin[j + 1] - 1;
  return structure.row_in_panel[last] + structure.block_size(structure.row_block[last]);
}

}  // namespace

SymmetricProduct::SymmetricProduct(const BlockStructure& structure, int num_threads)
    : structure_(structure), pool_(CountThreads(structure, num_threads)) {
  MakeRanges();
}

void SymmetricProduct::MakeRanges() {
  const int num_blocks = structure_.num_blocks();
  const int64_t num_values = structure_.num_values;
  const int64_t num_ranges = CountRanges(structure_);
  int64_t values_before = 0;
  for (int j = 0; j < num_blocks; ++j) {
    const auto ranges = static_cast<int64_t>(ranges_.size());
    if (ranges == 0 || values_before >= num_values * ranges / num_ranges) {
      ranges_.emplace_back();
      ranges_.back().begin_block = j;
      ranges_.back().begin_row = structure_.offset[j];
    }
    ColumnRange& range = ranges_.back();
    const int rows = PanelRows(structure_, j);
    const int last_block = structure_.row_block[structure_.column_begin[j + 1] - 1];
    range.end_block = j + 1;
    range.end_row = std::max(range.end_row, structure_.offset[last_block + 1]);
    range.panel_x.resize(std::max<size_t>(range.panel_x.size(), rows));
    values_before += static_cast<int64_t>(rows) * structure_.block_size(j);
  }
  for (ColumnRange& range : ranges_) {
    range.sum.resize(range.end_row - range.begin_row);
    range.panel_y.resize(range.panel_x.size());
  }
}

void SymmetricProduct::Multiply(const BlockValues& values, const double* x, double* y) {
  const auto num_ranges = static_cast<int>(ranges_.size());
  pool_.Run([&](int thread) {
    const int end = num_ranges * (thread + 1) / pool_.num_threads();
    for (int s = num_ranges * thread / pool_.num_threads(); s < end; ++s) {
      MultiplyRange(values.data(), x, &ranges_[s]);
    }
  });
  std::fill(y, y + structure_.num_columns(), 0.0);
  for (const ColumnRange& range : ranges_) {
    double* rows = y + range.begin_row;
    for (size_t i = 0; i < range.sum.size(); ++i) rows[i] += range.sum[i];
  }
}

void SymmetricProduct::MultiplyRange(const double* values, const double* x,
                                     ColumnRange* range) const {
  std::fill(range->sum.begin(), range->sum.end(), 0.0);
  for (int j = range->begin_block; j < range->end_block; ++j) MultiplyPanel(values, j, x, range);
}

void SymmetricProduct::MultiplyPanel(const double* values, int block, const double* x,
                                     ColumnRange* range) const {
  const BlockStructure& s = structure_;
  const int size = s.block_size(block);
  const int64_t stride = s.panel_stride[block];
  const double* panel = values + s.panel_begin[block];
  const double* x_j = x + s.offset[block];
  double* y_j = &range->sum[s.offset[block] - range->begin_row];
  // In the panel of a factor, the rows of other columns are above.
  const int top = s.row_in_panel[s.column_begin[block]];
  MultiplyDiagonalBlock(panel + top, stride, size, x_j, y_j);

  // The rows from the end of the diagonal block on, gathered.
  const int64_t first = s.column_begin[block] + 1;
  const int64_t last = s.column_begin[block + 1];
  for (int64_t e = first; e < last; ++e) {
    const int row = s.offset[s.row_block[e]];
    std::copy_n(x + row, s.block_size(s.row_block[e]), &range->panel_x[s.row_in_panel[e]]);
  }
  const int rows = PanelRows(s, block);
  std::fill_n(range->panel_y.begin(), rows, 0.0);
  for (int begin = top + size; begin < rows; begin += kRowsAtATime) {
    const int count = std::min(kRowsAtATime, rows - begin);
    const double* rows_x = range->panel_x.data() + begin;
    double* rows_y = range->panel_y.data() + begin;
    int c = 0;
    for (; c + 3 <= size; c += 3) {
      MultiplyColumns<3>(panel + c * stride + begin, stride, count, x_j + c, rows_x, rows_y,
                         y_j + c);
    }
    for (; c < size; ++c) {
      MultiplyColumns<1>(panel + c * stride + begin, stride, count, x_j + c, rows_x, rows_y,
                         y_j + c);
    }
  }
  for (int64_t e = first; e < last; ++e) {
    double* y_rows = &range->sum[s.offset[s.row_block[e]] - range->begin_row];
    const double* panel_rows = &range->panel_y[s.row_in_panel[e]];
    for (int r = 0; r < s.block_size(s.row_block[e]); ++r) y_rows[r] += panel_rows[r];
  }
}

}  // namespace bundle

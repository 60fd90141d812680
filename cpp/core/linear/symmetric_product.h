#pragma once

/// Products with a symmetric block matrix (derived in symmetric_product.cpp).

#include <vector>

#include "core/linear/block_structure.h"
#include "core/parallel/thread_pool.h"

namespace bundle {

/// Products with S, computed from its lower triangle.
class SymmetricProduct {
 public:
  /// Keeps a reference to the structure.
  SymmetricProduct(const BlockStructure& structure, int num_threads);

  /// y = S x; the bits do not depend on the number of threads.
  void Multiply(const BlockValues& values, const double* x, double* y);

 private:
  /// Consecutive block columns and the rows that they reach.
  struct ColumnRange {
    int begin_block = 0;
    int end_block = 0;
    int begin_row = 0;
    int end_row = 0;
    std::vector<double> sum;      ///< the range's contribution to y, from begin_row on
    std::vector<double> panel_x;  ///< x and y for the rows of one panel, contiguous
    std::vector<double> panel_y;
  };

  void MakeRanges();
  void MultiplyRange(const double* values, const double* x, ColumnRange* range) const;
  void MultiplyPanel(const double* values, int block, const double* x, ColumnRange* range) const;

  const BlockStructure& structure_;
  ThreadPool pool_;
  std::vector<ColumnRange> ranges_;
};

}  // namespace bundle

#pragma once

#include <vector>

#include "core/fused/reduced/reduced_system.h"
#include "core/fused/thread_pool.h"

namespace bundle::fused {

/// Products with S, from its lower triangle.
class SymmetricProduct {
 public:
  /// Keeps a reference to the structure.
  SymmetricProduct(const ReducedStructure& structure, int num_threads);

  /// y = S x; the same for any number of threads.
  void Multiply(const std::vector<double>& values, const double* x, double* y);

 private:
  /// Consecutive block columns and the rows that they reach.
  struct Slice {
    int begin_block = 0;
    int end_block = 0;
    int begin_row = 0;
    int end_row = 0;
    std::vector<double> sum;      ///< their share of y, from begin_row on
    std::vector<double> panel_x;  ///< x and y of the rows of one panel, side by side
    std::vector<double> panel_y;
  };

  void MakeSlices();
  void MultiplySlice(const double* values, const double* x, Slice* slice) const;
  void MultiplyPanel(const double* values, int block, const double* x, Slice* slice) const;

  const ReducedStructure& structure_;
  ThreadPool pool_;
  std::vector<Slice> slices_;
};

}  // namespace bundle::fused

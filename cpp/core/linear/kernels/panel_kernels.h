#pragma once

/// The arithmetic of a supernodal factor's panels (supernodal_cholesky.cpp), compiled once for each
/// instruction set. A pose graph has panels of 3 to 30 columns: a call of BLAS, which copies its
/// operands into packed buffers, takes longer than their arithmetic.
///
/// Panels are column-major. Each entry of a result is a sum over columns in their order, by one
/// accumulator (panel_kernels.cpp). So its bits do not depend on the rows and columns that a call
/// processes with it, and any division of a panel among calls gives the same bits.

#include <cstdint>

namespace bundle {

/// Consecutive rows that are consecutive in another panel, too.
struct RowRange {
  int source, target, length;
};

struct PanelKernels {
  /// Entries on and below the diagonal of C -= A A_top^T, where A_top is the first `columns` rows
  /// of A (rows x width). Entries above the diagonal are undefined.
  void (*subtract_product)(const double* a, int64_t stride, int rows, int columns, int width,
                           double* c, int64_t c_stride);
  /// The same for C = A A_top^T.
  void (*product)(const double* a, int64_t stride, int rows, int columns, int width, double* c,
                  int64_t c_stride);
  /// Subtracts the lower triangle of a product of `columns` columns from the rows and columns
  /// `target` of `to`; the ranges refer to the product's rows, of which the first are its columns.
  void (*scatter)(const double* product, int64_t stride, int columns, const RowRange* ranges,
                  int num_ranges, double* to, int64_t to_stride);
  /// Factorises the first `width` rows of a panel, D = L L^T, and replaces the others up to
  /// `height`, B, by B L^-T. Returns 0, or the order of a leading minor that is not positive
  /// definite.
  int (*factorize)(double* panel, int64_t stride, int height, int width);
  /// Replaces further rows B by B L^-T, after factorize.
  void (*solve_rows)(const double* panel, int64_t stride, int width, double* b, int rows);
  /// y = L^-1 y for the first `width` entries of y; below = B y.
  void (*forward)(const double* panel, int64_t stride, int height, int width, double* y,
                  double* below);
  /// y = L^-T (y - B^T below).
  void (*backward)(const double* panel, int64_t stride, int height, int width, double* y,
                   const double* below);
};

/// The kernels of the best instruction set that the machine has and BUNDLE_INSTRUCTION_SET allows.
const PanelKernels& SelectPanelKernels();

}  // namespace bundle

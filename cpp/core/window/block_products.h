#pragma once

/// Products of small matrices, added to blocks of a window's system. Nearly all of them are between
/// poses of images; the compiler knows these sizes.

#include <cstdint>
#include <type_traits>

#include "core/window/window.h"

namespace bundle {

inline double Squared(double x) { return x * x; }

/// out (m x n, column-major) += A^T B of rows x m and rows x n matrices, row-major.
template <int kM, int kN, int kRows>
void AddFixedProduct(const double* a, const double* b, double* out, int64_t stride) {
  for (int c = 0; c < kN; ++c) {
    double* const column = out + c * stride;
    for (int r = 0; r < kM; ++r) {
      double sum = 0;
      for (int k = 0; k < kRows; ++k) sum += a[k * kM + r] * b[k * kN + c];
      column[r] += sum;
    }
  }
}

inline void AddProduct(const double* a, int m, const double* b, int n, int rows, double* out,
                       int64_t stride) {
  if (rows == 2 && m == kPoseSize && n == kPoseSize) {  // the case of image poses
    return AddFixedProduct<kPoseSize, kPoseSize, 2>(a, b, out, stride);
  }
  for (int k = 0; k < rows; ++k) {
    for (int c = 0; c < n; ++c) {
      const double factor = b[k * n + c];
      if (factor == 0) continue;  // half of the entries of an inertial factor are zero
      double* const column = out + c * stride;
      for (int r = 0; r < m; ++r) column[r] += a[k * m + r] * factor;
    }
  }
}

/// out (m x n, column-major) -= A^T B of 3 x m and 3 x n matrices, row-major.
inline void SubtractProduct(const double* a, int m, const double* b, int n, double* out,
                            int64_t stride) {
  const auto subtract = [=](const auto rows) {
    for (int c = 0; c < n; ++c) {
      const double x = b[c], y = b[n + c], z = b[2 * n + c];
      double* const column = out + c * stride;
      for (int r = 0; r < rows; ++r) {
        column[r] -= a[r] * x + a[rows + r] * y + a[2 * rows + r] * z;
      }
    }
  };
  if (m == kPoseSize) return subtract(std::integral_constant<int, kPoseSize>());
  subtract(m);
}

}  // namespace bundle
